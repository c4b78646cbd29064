"""Recordings that are a folder of RGB images: DIGIT, GelSight Mini, Taxim's raw frames.

An image called background, blank, flat, ref or bg is untouched skin; one whose name says ball, press, sphere or bead is
a calibration press.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

from host_sync.errors import FrameSetError
from host_sync.frames.sequence import SUFFIXES, natural_order
from host_sync.importers.draft import Draft, DraftPress, DraftScan, Said

AT_REST: Final = re.compile(r"(background|blank|flat|ref|bg)([-_ ]?\d+)?", re.IGNORECASE)
PRESSED: Final = re.compile(r"(ball|press|sphere|bead)", re.IGNORECASE)
MOVIES: Final = (".mp4", ".avi", ".mov", ".mkv", ".webm")


def import_images(source: Path, said: Said) -> Draft:
    """A folder of RGB images.

    Raises
    ------
    FrameSetError
        It holds no images.
    """
    files = sorted(
        (one for one in source.iterdir() if one.suffix.lower() in SUFFIXES and one.name[0] != "."), key=natural_order
    )
    if not files:
        _check_movies(source)
        raise FrameSetError(f"{source}: holds no PNG, TIFF or JPEG images: name the folder of the frames")
    rest = said.reference or next((one for one in files if AT_REST.fullmatch(one.stem)), None)
    frames = [one for one in files if rest is None or one.resolve() != rest.resolve()]
    pressed = [one for one in frames if PRESSED.search(one.stem)]
    return Draft(
        name=source.resolve().name,
        pixel_pitch_um=said.pixel_pitch_um,
        encoding=said.encoding,
        reference=(rest,) if rest else (),
        presses=tuple(DraftPress((one,), said.ball_radius_mm) for one in pressed),
        scans=tuple(DraftScan(one.stem, (one,)) for one in frames),
    )


def _check_movies(source: Path) -> None:
    """Say that movies are not read where a folder holds nothing else.

    Raises
    ------
    FrameSetError
        Names the first one, and how its frames become images.
    """
    movie = next((one for one in sorted(source.iterdir()) if one.suffix.lower() in MOVIES), None)
    if movie is not None:
        raise FrameSetError(
            f"{movie}: a movie does not say which frames are presses: save its frames as images, for example with "
            f"ffmpeg -i {movie.name} frame-%04d.png, and call those of the ball ball-…"
        )
