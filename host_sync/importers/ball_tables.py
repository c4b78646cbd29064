"""Calibration folders that list one labelled ball an image: those of gs_sdk and of py3DCal."""

from __future__ import annotations

import re
import zipfile
import zlib
from codecs import BOM_UTF8
from dataclasses import replace
from pathlib import Path
from typing import Final

import msgspec
import numpy as np

from hal.decoding import decode_json
from host_sync.csv_table import number_in, read_table
from host_sync.errors import FrameSetError
from host_sync.importers.draft import SHOWN_EVERY, Circle, Draft, DraftPress, DraftScan, Said, inside, left_out

CATALOGUE: Final = "catalog.csv"
FOLDER, DIAMETER = "experiment_reldir", "diameter(mm)"
ANNOTATIONS: Final = "annotations/annotations.csv"
METADATA: Final = "annotations/metadata.json"


def import_gs_sdk(source: Path, said: Said) -> Draft:
    """A calibration folder of gs_sdk: `catalog.csv`, folders with `gelsight.png` and `label.npz`, `background.png`.

    Raises
    ------
    FrameSetError
        There is no catalogue, or none of its images is there.
    """
    presses, missing = [], []
    columns = (FOLDER,) if said.ball_radius_mm else (FOLDER, DIAMETER)
    for row in read_table(source / CATALOGUE, FrameSetError, columns):
        folder, diameter = inside(source, row[FOLDER]), row.get(DIAMETER, "")
        image = folder / "gelsight.png"
        if image.is_file():
            radius = said.ball_radius_mm or _positive(diameter, source / CATALOGUE) / 2.0
            presses.append(DraftPress((image,), radius, _label(folder / "label.npz")))
        else:
            missing.append(str(image.relative_to(source)))
    draft = _draft(source, said, presses, missing, source / "background.png", said.pixel_pitch_um)
    return replace(draft, states_diameters=said.ball_radius_mm is None)


def import_py3dcal(source: Path, said: Said) -> Draft:
    """A calibration folder of py3DCal: `probe_images/`, `blank_images/blank.png`, `annotations/`.

    Raises
    ------
    FrameSetError
        There are no annotations, or none of their images is there.
    """
    facts: dict[str, object] = {}
    if (source / METADATA).is_file():
        try:
            facts = decode_json((source / METADATA).read_bytes().removeprefix(BOM_UTF8), dict[str, object])
        except OSError as error:
            raise FrameSetError(f"{source / METADATA}: cannot be read ({error.strerror}): annotate again") from error
        except msgspec.ValidationError as error:
            raise FrameSetError(f"{source / METADATA}: is no table of facts: annotate again") from error
        except msgspec.DecodeError as error:
            raise FrameSetError(f"{source / METADATA}: {error}: annotate again") from error
    scale, radius_mm = facts.get("px_per_mm"), facts.get("probe_radius_mm")
    pitch_um = said.pixel_pitch_um or (1e3 / scale if isinstance(scale, int | float) and scale > 0 else None)
    known = said.ball_radius_mm or (float(radius_mm) if isinstance(radius_mm, int | float) else None)
    presses, missing = [], []
    for row in read_table(source / ANNOTATIONS, FrameSetError):
        name = re.split(r"[/\\]", next(iter(row.values()), ""))[-1]
        image = inside(source, f"probe_images/{name}")
        if image.is_file():
            presses.append(DraftPress((image,), known))  # places are the probe's, not seen; the balls are found
        else:
            missing.append(str(image.relative_to(source)))
    return _draft(source, said, presses, missing, source / "blank_images" / "blank.png", pitch_um)


def _draft(
    source: Path, said: Said, presses: list[DraftPress], missing: list[str], rest: Path, pitch_um: float | None
) -> Draft:
    if not presses:
        raise FrameSetError(f"{source}: none of the listed images is there: fetch the folder whole")
    reference = said.reference or (rest if rest.is_file() else None)
    shown = presses[::SHOWN_EVERY]
    scans = [DraftScan(f"press-{SHOWN_EVERY * number:02d}", press.images) for number, press in enumerate(shown)]
    return Draft(
        name=source.resolve().name,
        pixel_pitch_um=pitch_um,
        encoding=said.encoding,
        reference=(reference,) if reference else (),
        presses=tuple(presses),
        scans=tuple(scans),
        notes=left_out(missing),
    )


def _positive(value: str, path: Path) -> float:
    """The length, with a decimal point or comma, and its unit or not."""
    number = number_in(value.removesuffix("mm"))
    if not 0.0 < number < float("inf"):
        raise FrameSetError(f"{path}: {value!r} is no length: correct the table")
    return number


def _label(path: Path) -> tuple[Circle, ...]:
    """The contact that a label names; none where there is no label."""
    if not path.is_file():
        return ()
    try:
        with np.load(path, allow_pickle=False) as label:
            column, row = (float(value) for value in label["center"])
            return ((column, row, float(label["radius"])),)
    except (OSError, ValueError, KeyError, TypeError, EOFError, RuntimeError, zlib.error, zipfile.BadZipFile) as error:
        raise FrameSetError(f"{path}: is no label of gs_sdk: label that press again") from error
