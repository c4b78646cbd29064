"""Recognition of the program that wrote a folder, by the folder's contents."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Final, Literal

from host_sync.errors import FrameSetError
from host_sync.frames.sequence import SUFFIXES
from host_sync.importers.ball_tables import (
    ANNOTATIONS,
    CATALOGUE,
    PACK,
    find_circle_table,
    import_annotated,
    import_gs_sdk,
    import_py3dcal,
    import_taxim,
)
from host_sync.importers.draft import Draft, Said
from host_sync.importers.gelsight_scan import SCAN_FILE, import_gelsight
from host_sync.importers.image_folder import MOVIES, import_images

Kind = Literal["gelsight", "gs_sdk", "py3dcal", "taxim", "fots", "digit", "images"]

IMPORTERS: Final[dict[Kind, Callable[[Path, Said], Draft]]] = {
    "gelsight": import_gelsight,
    "gs_sdk": import_gs_sdk,
    "py3dcal": import_py3dcal,
    "taxim": import_taxim,
    "fots": import_annotated,
    "digit": import_images,
    "images": import_images,
}

WRITTEN_BY: Final[dict[Kind, str]] = {
    "gelsight": "scans of GelSight's programs",
    "gs_sdk": "a calibration of gs_sdk",
    "py3dcal": "a calibration of py3DCal",
    "taxim": "a data pack of Taxim",
    "fots": "annotated circles of FOTS or digit-depth",
    "digit": "a folder of images",
    "images": "a folder of images",
}

OTHER_IMAGES: Final = (".bmp", ".webp", ".gif", ".heic", ".jp2", ".ppm", ".jls")


def recognize(source: Path) -> Kind:
    """Return the kind of a folder, by the files that it holds.

    Raises
    ------
    FrameSetError
        Nothing in it is known; says what is.
    """
    if (source / SCAN_FILE).is_file() or any(source.glob(f"*/{SCAN_FILE}")):
        return "gelsight"
    if (source / CATALOGUE).is_file():
        return "gs_sdk"
    if (source / ANNOTATIONS).is_file():
        return "py3dcal"
    if (source / PACK).is_file():
        return "taxim"
    if find_circle_table(source) is not None:
        return "fots"
    if any(one.suffix.lower() in (*SUFFIXES, *MOVIES) for one in source.iterdir()):
        return "images"
    if any(one.suffix.lower() in OTHER_IMAGES for one in source.iterdir()):
        raise FrameSetError(f"{source}: holds images of a kind that is not read: save them as PNG, TIFF or JPEG")
    inner = next((one for one in sorted(source.iterdir()) if one.is_dir() and _is_known(one)), None)
    hint = f"; {inner} is one" if inner else ""
    raise FrameSetError(
        f"{source}: holds no images, and no {SCAN_FILE}, {CATALOGUE}, {ANNOTATIONS}, {PACK} or table of circles: name "
        f"the folder that holds them{hint}"
    )


def read_folder(source: Path, kind: Kind, said: Said) -> Draft:
    """Return the draft of a folder of this kind, without copies of presses, and with what the user stated.

    Raises
    ------
    FrameSetError
        As for the kind's importer, or a file cannot be read.
    """
    draft = IMPORTERS[kind](source, said).without_copies()
    return replace(
        draft,
        pitch_down_um=said.pitch_down_um,
        states_diameters=said.states_diameter or draft.states_diameters,
    )


def _is_known(folder: Path) -> bool:
    try:
        return recognize(folder) is not None
    except (FrameSetError, OSError):
        return False
