"""Pictures as files, in the format of their suffix, written atomically."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import cv2

from device.io.atomic import write_output
from host_sync.errors import RenderError, ResultError
from host_sync.render.relief import Picture

SUFFIXES: Final = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".webp")
MAX_STEM: Final = 80


def write_any_picture(path: Path, picture: Picture) -> None:
    """Write a picture of shape (H, W, 3) in the format of the suffix.

    Raises
    ------
    RenderError
        The suffix is not supported.
    ResultError
        The place cannot be written.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise RenderError(f"{path}: is not a picture format: use .png, .jpg, .tif or .webp")
    made, data = cv2.imencode(path.suffix.lower(), picture[..., ::-1])
    if not made:
        raise RenderError(f"{path}: the picture is too large for this format: choose .png or a smaller --width")
    make_folder(path.parent)
    write_output(path, data.tobytes())


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
    """A file name without suffix for each title: letters, digits, . _ and - only, all different."""
    stems: list[str] = []
    for title in titles:
        stem = re.sub(r"[^\w.-]+", "-", title, flags=re.ASCII).strip("-.")[:MAX_STEM] or "relief"
        number, unique = 2, stem
        while unique in stems:
            unique, number = f"{stem}-{number}", number + 1
        stems.append(unique)
    return stems
