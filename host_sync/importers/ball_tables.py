"""Calibration folders that list one labelled ball an image: those of gs_sdk, of py3DCal and of Taxim.

Taxim's is `dataPack.npz` beside the images that it was annotated on, with each ball's centre and contact radius as a
hand set them. A pack states neither pitch nor ball.
"""

from __future__ import annotations

import math
import re
import zipfile
import zlib
from codecs import BOM_UTF8
from dataclasses import replace
from pathlib import Path
from typing import Final

import msgspec
import numpy as np

from hal.validation import decode_json
from host_sync.csv_table import number_in, read_table
from host_sync.errors import FrameSetError
from host_sync.frames.sequence import SUFFIXES, natural_order
from host_sync.importers.draft import (
    SHOWN_EVERY,
    Circle,
    Draft,
    DraftPress,
    DraftScan,
    Said,
    inside,
    largest_contact_px,
    left_out,
)

CATALOGUE: Final = "catalog.csv"
FOLDER, DIAMETER = "experiment_reldir", "diameter(mm)"
ANNOTATIONS: Final = "annotations/annotations.csv"
METADATA: Final = "annotations/metadata.json"


def import_gs_sdk(source: Path, said: Said) -> Draft:
    """Return the draft of a calibration folder of gs_sdk.

    It holds `catalog.csv`, `background.png`, and folders with `gelsight.png` and `label.npz`.

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
    """Return a calibration folder of py3DCal: `probe_images/`, `blank_images/blank.png`, `annotations/`.

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
    if not presses and not missing:
        raise FrameSetError(f"{source}: its table lists no press: fill it in, or name the folder of the images")
    if not presses:
        raise FrameSetError(
            f"{source}: none of the listed images is there, such as {missing[0]}: fetch the whole folder"
        )
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
    """Return the length, with a decimal point or comma, and its unit or not."""
    number = number_in(value.removesuffix("mm"))
    if not 0.0 < number < float("inf"):
        raise FrameSetError(f"{path}: {value!r} is no length: correct the table")
    return number


def _label(path: Path) -> tuple[Circle, ...]:
    """Return the contact that a label names; none where there is no label."""
    if not path.is_file():
        return ()
    try:
        with np.load(path, allow_pickle=False) as label:
            column, row = (float(value) for value in label["center"])
            return ((column, row, float(label["radius"])),)
    except (OSError, ValueError, KeyError, TypeError, EOFError, RuntimeError, zlib.error, zipfile.BadZipFile) as error:
        raise FrameSetError(f"{path}: is no label of gs_sdk: label that press again") from error


# Calibration folders of FOTS and digit-depth: a table of circles that a person drew, images, a configuration.
#
# A circle is drawn around all of the ball that shows, where the skin has left it already: its contact is narrower.

COLUMNS: Final = ("img_names", "center_x", "center_y", "radius")
CONTACT_OF_RING: Final = 0.85
"""The contact's radius over that of the ring that a person sees."""

_SCALE: Final = re.compile(r"^\s*mm_to_pix(?:el)?:\s*([^\s#]+)", re.MULTILINE)
_AT_REST: Final = re.compile(r"0+|background|blank|flat|ref|bg", re.IGNORECASE)


def find_circle_table(source: Path) -> Path | None:
    """Return the table of circles in a folder, in its csv folder or beside its images; None where there is none."""
    for one in (*sorted(source.glob("*.csv")), *sorted(source.glob("csv/*.csv"))):
        try:
            read_table(one, FrameSetError, COLUMNS)
        except FrameSetError:
            continue
        return one
    return None


def import_annotated(source: Path, said: Said) -> Draft:
    """Return a folder with a table of circles and their images, which lie in it or in one of its folders.

    Raises
    ------
    FrameSetError
        There is no table, a number in it is none, or none of its images is there.
    """
    table = find_circle_table(source)
    if table is None:
        raise FrameSetError(f"{source}: holds no table with the columns {', '.join(COLUMNS)}: name its folder")
    pitch_um = said.pixel_pitch_um or _stated_pitch_um(source)
    rows = read_table(table, FrameSetError, COLUMNS)
    largest = largest_contact_px(table, [number_in(row["radius"]) for row in rows], said.ball_radius_mm, pitch_um)
    circles: dict[str, list[Circle]] = {}
    for row in rows:
        name = re.split(r"[/\\]", row[COLUMNS[0]])[-1].casefold()  # paths of the computer where they were drawn
        circles.setdefault(name, []).append(_contact(row, largest, table))
    images = _images(source, set(circles))
    presses = [
        DraftPress((images[name],), said.ball_radius_mm, tuple(drawn))
        for name, drawn in circles.items()
        if name in images
    ]
    if not presses:
        raise FrameSetError(f"{source}: none of the images that {table.name} lists is there: fetch the whole folder")
    folder = presses[0].images[0].parent
    rest = said.reference or next(
        (one for place in (folder, source) for one in sorted(place.iterdir()) if _is_at_rest(one, circles)), None
    )
    return Draft(
        name=source.resolve().name,
        pixel_pitch_um=pitch_um,
        encoding=said.encoding,
        reference=(rest,) if rest else (),
        presses=tuple(presses),
        scans=tuple(DraftScan(press.images[0].stem, press.images) for press in presses[::SHOWN_EVERY]),
        notes=left_out([name for name in circles if name not in images]),
    )


def _images(source: Path, names: set[str]) -> dict[str, Path]:
    """Return the folder that holds most of the images, by name."""
    folders = [source, *(one for one in sorted(source.iterdir()) if one.is_dir())]
    held = [{one.name.casefold(): one for one in sorted(place.iterdir(), key=natural_order)} for place in folders]
    best = max(held, key=lambda files: len(names & files.keys()))
    return {name: best[name] for name in names & best.keys()}


def _is_at_rest(path: Path, circles: dict[str, list[Circle]]) -> bool:
    named = path.suffix.lower() in SUFFIXES and _AT_REST.fullmatch(path.stem) is not None
    return named and path.name.casefold() not in circles


def _contact(row: dict[str, str], largest: float | None, table: Path) -> Circle:
    column, line, ring = (number_in(row[name]) for name in COLUMNS[1:])
    if not (math.isfinite(column + line) and 0.0 < ring < math.inf):
        given = ", ".join(row[name] for name in COLUMNS[1:])
        raise FrameSetError(f"{table}: {row[COLUMNS[0]]}: {given!r} is no circle: correct the table")
    contact = CONTACT_OF_RING * ring
    return column, line, min(contact, largest) if largest else contact


def _stated_pitch_um(source: Path) -> float | None:
    """Return the pixel pitch that a configuration beside the images states."""
    for one in sorted(source.glob("config/*.yaml")):
        found = _SCALE.search(one.read_text(encoding="utf-8", errors="replace"))
        pixels = number_in(found[1].strip("\"'")) if found else math.nan
        if 0.0 < pixels < math.inf:
            return 1e3 / pixels
    return None


PACK: Final = "dataPack.npz"
PACK_SUFFIXES: Final = (".png", ".jpg", ".jpeg", ".ppm")
PACK_AT_REST: Final = ("frame_0", "ball0")
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
    at_rest = sorted((one for one in source.iterdir() if _is_at_rest_in_pack(one)), key=natural_order)
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


def _is_at_rest_in_pack(path: Path) -> bool:
    return path.stem in PACK_AT_REST and path.suffix.lower() in PACK_SUFFIXES


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
