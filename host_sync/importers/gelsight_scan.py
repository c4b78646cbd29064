"""Scan folders of GelSight's SDK and Mobile: `scan.yaml`, images, the maker's height map (TMD).

Grey images, one a light, come from machine-vision cameras whose values are linear; how a single RGB image encodes light
is not said. A folder with annotated circles and a ball's radius is a calibration press. Its circles are drawn at the
ball's equator, so that the trusted contact is at most 0.8 of the radius. A folder called flat... is untouched skin.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from host_sync.errors import FrameSetError
from host_sync.importers.draft import Circle, Draft, DraftPress, DraftScan, Said, inside, largest_contact_px

SCAN_FILE: Final = "scan.yaml"
MM_TO_UM: Final = 1e3


@dataclass(frozen=True, slots=True)
class _Scan:
    folder: Path
    images: tuple[Path, ...]
    pitch_um: float | None
    radius_mm: float | None
    spacing_mm: float | None
    circles: tuple[Circle, ...]
    height_map: Path | None


def import_gelsight(source: Path, said: Said) -> Draft:
    """Return a scan's folder, or one that holds scans' folders.

    Raises
    ------
    FrameSetError
        There is no scan, or scans of different numbers of images are mixed.
    """
    files = [source / SCAN_FILE] if (source / SCAN_FILE).is_file() else sorted(source.glob(f"*/{SCAN_FILE}"))
    scans = [scan for scan in (_read(file) for file in files) if scan.images]
    if not scans:
        raise FrameSetError(f"{source}: holds no {SCAN_FILE} and its images: name a scan's folder or its parent")
    if len({len(scan.images) for scan in scans}) > 1:
        counts = ", ".join(f"{scan.folder.name} {len(scan.images)}" for scan in scans)
        raise FrameSetError(f"{source}: scans have different numbers of images ({counts}): import them apart")
    rest = said.reference.resolve() if said.reference else None
    reference = next((s for s in scans if s.folder.resolve() == rest or (not rest and _is_flat(s))), None)
    if rest is not None and reference is None:
        raise FrameSetError(f"{said.reference}: is no scan in {source}: name the folder of the untouched skin's scan")
    others = [scan for scan in scans if scan is not reference]
    pressed = [scan for scan in others if scan.circles]
    pitches = [scan.pitch_um for scan in [*pressed, *others] if scan.pitch_um]
    if not said.pixel_pitch_um and pitches and max(pitches) > 1.01 * min(pitches):
        span = f"{min(pitches):g} to {max(pitches):g} µm"
        raise FrameSetError(f"{source}: scans have pixel pitches of {span}: import them apart")
    pitch_um = said.pixel_pitch_um or (pitches[0] if pitches else None)
    count = len(scans[0].images)
    lights = [image.stem for image in scans[0].images]
    for scan in scans[1:]:
        if count > 1 and [image.stem for image in scan.images] != lights:
            raise FrameSetError(
                f"{source}: images are called {', '.join(lights)} in {scans[0].folder.name} and "
                f"{', '.join(image.stem for image in scan.images)} in {scan.folder.name}: which light is which is not "
                "known; import them apart"
            )
    return Draft(
        name=source.resolve().name,
        pixel_pitch_um=pitch_um,
        encoding=said.encoding or ("linear" if count > 1 else None),
        reference=reference.images if reference else (),
        presses=tuple(_press(scan, said.ball_radius_mm, pitch_um) for scan in pressed),
        scans=tuple(DraftScan(scan.folder.resolve().name, scan.images, scan.height_map) for scan in others),
        lights=tuple(lights) if count > 1 else (),
    )


def _press(scan: _Scan, radius_mm: float | None, pitch_um: float | None) -> DraftPress:
    radius = radius_mm or scan.radius_mm
    largest = largest_contact_px(scan.folder, [r for *_, r in scan.circles], radius, pitch_um)
    circles = tuple((x, y, min(r, largest) if largest else r) for x, y, r in scan.circles)
    return DraftPress(scan.images, radius, circles, scan.spacing_mm)


def _is_flat(scan: _Scan) -> bool:
    return scan.folder.resolve().name.casefold().startswith("flat")


def _read(file: Path) -> _Scan:
    """Return the contents of a scan's file."""
    keys = read_plain_yaml(file)
    names = keys.get("images", [])
    listed = [name for name in names if isinstance(name, str)] if isinstance(names, list) else []
    images = [inside(file.parent, name) for name in listed]
    if missing := [image.name for image in images if not image.is_file()]:
        raise FrameSetError(f"{file}: its image {missing[0]!r} is not there: fetch the whole folder")
    marks = keys.get("annotations", [])
    tables = [mark for mark in marks if isinstance(mark, dict)] if isinstance(marks, list) else []
    circles = [
        (_number(t.get("x")), _number(t.get("y")), _number(t.get("r"))) for t in tables if "Circle" in t.get("type", "")
    ]
    heights = keys.get("activeheightmap")
    maps = [inside(file.parent, heights)] if isinstance(heights, str) and heights else sorted(file.parent.glob("*.tmd"))
    return _Scan(
        file.parent,
        tuple(images),
        _length(keys.get("mmperpixel"), MM_TO_UM),
        _length(keys.get("calibradius")),
        _length(keys.get("calibspacing")),
        tuple((x, y, r) for x, y, r in circles if x is not None and y is not None and r),
        next((one for one in maps if one.is_file()), None),
    )


def _number(value: object) -> float | None:
    try:
        number = float(value) if isinstance(value, str) else math.nan
    except ValueError:
        return None
    return number if math.isfinite(number) else None


def _length(value: object, factor: float = 1.0) -> float | None:
    number = _number(value)
    return number * factor if number is not None and number > 0.0 else None


# The part of YAML that GelSight's `scan.yaml` uses: keys with values, lists of values, lists of such tables.
#
# Deeper tables are skipped. Values stay text; who asks for a number reads one.

Table = dict[str, str]
MAX_BYTES: Final = 4 << 20


def read_plain_yaml(path: Path) -> dict[str, str | list[str] | list[Table]]:
    """Return keys of the file at its outermost level.

    Raises
    ------
    FrameSetError
        The file cannot be read, is too large or no text.
    """
    try:
        with path.open("rb") as stream:
            data = stream.read(MAX_BYTES + 1)
    except OSError as error:
        raise FrameSetError(f"{path}: cannot be read ({error.strerror}): name another folder") from error
    if len(data) > MAX_BYTES:
        raise FrameSetError(f"{path}: is larger than any scan's description: name another folder")
    try:
        lines = data.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise FrameSetError(f"{path}: is no text: name another folder") from error
    found: dict[str, str | list[str] | list[Table]] = {}
    key, tables, values = "", list[Table](), list[str]()
    for line in lines:
        text = line.strip()
        if not text or text.startswith("#"):
            continue
        if line[0] not in " -\t":
            key, _, value = text.partition(":")
            tables, values = [], []
            found[key] = value.strip().strip("\"'")
        elif text.startswith("- ") and ":" in text:
            tables.append(_pair(text[2:]))
            found[key] = tables
        elif text.startswith("- "):
            values.append(text[2:].strip().strip("\"'"))
            found[key] = values
        elif tables and ":" in text:
            tables[-1].update(_pair(text))
    return found


def _pair(text: str) -> Table:
    name, _, value = text.partition(":")
    return {name.strip(): value.strip().strip("\"'")}
