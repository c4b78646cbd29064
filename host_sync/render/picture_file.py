"""Pictures as files of the kind that their name says, whole or not at all."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import cv2

from host_sync.errors import RenderError, ResultError
from host_sync.render.relief import Picture

SUFFIXES: Final = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".webp")
_LONGEST: Final = 80


def write_any_picture(path: Path, picture: Picture) -> None:
    """Write a picture of shape (H, W, 3) as its suffix says.

    Raises
    ------
    RenderError
        No picture has that suffix.
    ResultError
        The place cannot be written.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise RenderError(f"{path}: is no kind of picture: name it .png, .jpg, .tif or .webp")
    made, data = cv2.imencode(path.suffix.lower(), picture[..., ::-1])
    if not made:
        raise RenderError(f"{path}: the picture is too large for this kind of file: choose .png or a smaller --width")
    partial = path.with_name(f".{path.name}.partial")
    try:
        make_folder(path.parent)
        partial.write_bytes(data.tobytes())
        partial.replace(path)
    except OSError as error:
        if isinstance(error, ResultError):
            raise
        partial.unlink(missing_ok=True)
        raise ResultError(f"{path} cannot be written ({error.strerror or error}): choose another place") from error


def make_folder(folder: Path) -> None:
    """Make a folder and those above it.

    Raises
    ------
    ResultError
        It cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ResultError(f"{folder} cannot be made ({error.strerror or error}): choose another place") from error


def file_stems(titles: Sequence[str]) -> list[str]:
    """A file name without suffix for each title: letters, digits, . _ and - only, no two alike."""
    stems: list[str] = []
    for title in titles:
        stem = re.sub(r"[^\w.-]+", "-", title, flags=re.ASCII).strip("-.")[:_LONGEST] or "relief"
        number, unique = 2, stem
        while unique in stems:
            unique, number = f"{stem}-{number}", number + 1
        stems.append(unique)
    return stems
