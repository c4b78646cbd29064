"""Libraries that only a real board has: looked for by name before a driver imports them."""

from __future__ import annotations

from importlib.util import find_spec

from hal.errors import DriverMissing


def require(library: str, install: str) -> None:
    """Refuse in words when a library is not installed; `install` says how to get it.

    Raises
    ------
    DriverMissing
        It is not there.
    """
    if find_spec(library) is None:
        raise DriverMissing(f"the library {library} is not installed here: {install}")
