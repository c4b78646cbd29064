"""Data packs of Taxim's calibration: `dataPack.npz` beside the images that it was annotated on.

Each pressed ball's centre and contact radius were set by hand. A pack states neither pitch nor ball.
"""

from __future__ import annotations

import zipfile
import zlib
from pathlib import Path
from typing import Final

import numpy as np

from host_sync.errors import FrameSetError
from host_sync.frames.sequence import natural_order
from host_sync.importers.draft import SHOWN_EVERY, Draft, DraftPress, DraftScan, Said, inside, left_out

PACK: Final = "dataPack.npz"
SUFFIXES: Final = (".png", ".jpg", ".jpeg", ".ppm")
AT_REST: Final = ("frame_0", "ball0")
"""Names that Taxim's annotator takes for the image of untouched skin."""


def import_taxim(source: Path, said: Said) -> Draft:
    """Return a folder with a data pack and its images.

    Raises
    ------
    FrameSetError
        There is no pack, it is damaged, or none of its images is there.
    """
    names, centres, radii = _pack(source / PACK)
    presses, missing = [], []
    for name, (column, row), radius in zip(names, centres, radii, strict=True):
        image = inside(source, name)
        if image.is_file():
            presses.append(DraftPress((image,), said.ball_radius_mm, ((column, row, radius),)))
        else:
            missing.append(name)
    if not presses:
        raise FrameSetError(f"{source}: none of the images that {PACK} lists is there, such as {names[0]}")
    at_rest = sorted((one for one in source.iterdir() if _is_at_rest(one)), key=natural_order)
    reference = said.reference or next(iter(at_rest), None)
    shown = presses[::SHOWN_EVERY]
    return Draft(
        name=source.resolve().name,
        pixel_pitch_um=said.pixel_pitch_um,
        encoding=said.encoding,
        reference=(reference,) if reference else (),
        presses=tuple(presses),
        scans=tuple(DraftScan(press.images[0].stem, press.images) for press in shown),
        notes=left_out(missing),
    )


def _is_at_rest(path: Path) -> bool:
    return path.stem in AT_REST and path.suffix.lower() in SUFFIXES


def _is_text(path: Path) -> bool:
    try:
        with path.open("rb") as file:
            return file.read(64).isascii()
    except OSError:
        return False


def _pack(path: Path) -> tuple[list[str], list[tuple[float, float]], list[float]]:
    """Return names of the images, and the centres (column, row) and radii of their contacts, pixels."""
    if not path.is_file():
        raise FrameSetError(f"{path.parent}: holds no {PACK}: name the folder of the annotated images")
    try:
        with np.load(path, allow_pickle=False) as pack:
            names = [str(name) for name in pack["names"]]
            centres = [(float(column), float(row)) for column, row in pack["touch_center"]]
            radii = [float(radius) for radius in pack["touch_radius"]]
    except (OSError, ValueError, KeyError, TypeError, EOFError, RuntimeError, zlib.error, zipfile.BadZipFile) as error:
        if _is_text(path):
            raise FrameSetError(f"{path}: holds text, such as a pointer of Git LFS: fetch the file itself") from error
        raise FrameSetError(f"{path}: is no data pack of Taxim: annotate the images again") from error
    numbers = np.array([*radii, *(value for centre in centres for value in centre)])
    if not names or not len(names) == len(centres) == len(radii) or not np.isfinite(numbers).all():
        raise FrameSetError(f"{path}: lists {len(names)} names and {len(radii)} contacts: annotate the images again")
    return names, centres, radii
