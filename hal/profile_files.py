"""Places and names of the shipped board profiles; nothing is read, so that help can list them at once."""

from __future__ import annotations

from importlib import resources
from pathlib import Path


def profile_names() -> tuple[str, ...]:
    """Return names of the profiles shipped with the program, sorted."""
    return tuple(sorted(path.stem for path in profile_folder().glob("*.toml")))


def profile_folder() -> Path:
    """Return the folder of the shipped profiles: inside an installed wheel, else beside the package in a checkout."""
    package = Path(str(resources.files("hal")))
    shipped = package / "board"
    return shipped if shipped.is_dir() else package.parent / "board"
