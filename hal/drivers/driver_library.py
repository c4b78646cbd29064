"""Packages that only a real board has: checked before a driver imports them."""

from __future__ import annotations

from importlib.util import find_spec

from hal.errors import DriverMissing


def require_package(package: str, install: str) -> None:
    """Raise an error that says how to install a package (`install`) if it is missing.

    Raises
    ------
    DriverMissing
        The package is not installed.
    """
    if find_spec(package) is None:
        raise DriverMissing(f"the package {package} is not installed: {install}")
