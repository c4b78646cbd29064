"""Two results of one spot compared: where the second lies, their difference with its σ, changes, detection limits."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import msgspec
import numpy as np

from device.align import Pose
from device.io.atomic import atomic_directory
from device.surface import HeightMap, MaskArray
from host_sync.errors import ViewError
from host_sync.registration.difference import Difference, are_copies, difference
from host_sync.registration.fit import at_pitch, moved
from host_sync.render.picture_file import write_any_picture
from host_sync.render.relief_sheet import with_strip
from host_sync.render.shading import Picture
from host_sync.render.still import Still, render
from host_sync.results.field_file import write_field
from host_sync.results.reader import ResultSurface
from host_sync.same_spot.changes import Change, Limit, changes, is_elsewhere

RECORD_FILE: Final = "same_spot.json"
DIFFERENCE_FILE: Final = "difference_um.tif"
SIGMA_FILE: Final = "difference_sigma_um.tif"
PICTURE_FILE: Final = "difference.png"
MIN_COLUMNS: Final = 480
MAX_COLUMNS: Final = 1600
RING_UM: Final = 400.0
"""Radius of the ring around a change in the picture, at least."""

RING_RGB: Final = (220, 30, 30)
ERRORS_APART: Final = "the object moved far, and a result states no uncertainty: changes may be errors of the heights"


class SameSpotRecord(msgspec.Struct, frozen=True):
    """Contents of `same_spot.json`.

    shift_um : (rows, columns), displacement of the object in the second press, down and right positive
    shift_sigma_um : standard uncertainty of the shift along the direction that is known least; None if undetermined
    turn_deg : rotation of the object in the second press, clockwise on the screen
    registered_by, agreement_share : what found the place, and the correlation of the slopes there
    overlap_share, judged_share : common field, and field where a change can be judged, as fractions of the first press
    residual_um, median_um : root mean square of the difference, and median of its absolute value
    height_sigma_median_um : median of the difference's standard uncertainty; None if a result states none
    gain_share : by how much the second press reads relief higher, relative; taken off before changes are looked for
    changes : significant changes, most significant first
    limits : detection limits by diameter
    warnings : reasons to distrust the comparison
    """

    first: str
    second: str
    shift_um: tuple[float, float]
    shift_sigma_um: float | None
    turn_deg: float
    registered_by: str
    agreement_share: float
    overlap_share: float
    judged_share: float
    residual_um: float
    median_um: float
    height_sigma_median_um: float | None
    gain_share: float
    changes: tuple[Change, ...]
    limits: tuple[Limit, ...]
    warnings: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """The record of a comparison, and the difference on the grid of the first press."""

    record: SameSpotRecord
    difference: Difference
    pitch_um: float


def compared(first: ResultSurface, second: ResultSurface, near: tuple[float, float, float] | None = None) -> Comparison:
    """Return what changed from the first result to the second.

    near : (mm down, mm right, degrees clockwise) of the object in the second press, as a person saw it

    Raises
    ------
    ViewError
        They hardly overlap, or are copies of one press.
    RegistrationRefused
        Their registration cannot be trusted.
    """
    if are_copies(first.height.z_um, second.height.z_um):
        raise ViewError(
            f"{first.record.name} and {second.record.name} do not differ: they are copies of one press, not two presses"
        )
    pitch_um = first.height.pitch_um
    pose = None
    if near is not None:
        pose = Pose(1e3 * near[0] / pitch_um, 1e3 * near[1] / pitch_um, float(np.radians(near[2])))
    found = difference(first.height, second.height, (first.sigma_um, second.sigma_um), near=pose)
    changed = changes(first.height, found, _untouched(first, second, found))
    known = found.sigma_um is not None and bool(np.isfinite(found.sigma_um).any())
    record = SameSpotRecord(
        first=first.record.name,
        second=second.record.name,
        shift_um=found.shift_um,
        shift_sigma_um=found.shift_sigma_um,
        turn_deg=found.turn_deg,
        registered_by=found.registration.by,
        agreement_share=found.registration.agreement,
        overlap_share=found.overlap_share,
        judged_share=changed.judged_share,
        residual_um=found.residual_um,
        median_um=found.median_um,
        height_sigma_median_um=float(np.nanmedian(found.sigma_um)) if known and found.sigma_um is not None else None,
        gain_share=changed.gain,
        changes=changed.found,
        limits=changed.limits,
        warnings=(
            *((found.warning,) if found.warning else ()),
            *((ERRORS_APART,) if not known and is_elsewhere(first.height, found) else ()),
            *(f"{one.record.name}: {doubt.sentence}" for one in (first, second) for doubt in one.doubts),
        ),
    )
    return Comparison(record, found, pitch_um)


def _untouched(first: ResultSurface, second: ResultSurface, found: Difference) -> MaskArray | None:
    """Return the skin that neither press touched, bool array of the first map's shape; None where it is not known."""
    if first.untouched is None or second.untouched is None:
        return None
    at_rest = at_pitch(HeightMap(second.untouched.astype(np.float32), second.height.pitch_um), first.height.pitch_um)
    there = moved(at_rest, found.registration.pose, first.untouched.shape, 1)
    return np.asarray(first.untouched & (there > 0.5), np.bool_)


def write_comparison(comparison: Comparison, out: Path) -> None:
    """Write record, difference, its σ and a picture into a folder, which replaces an earlier comparison.

    Raises
    ------
    ResultError
        The folder cannot be written, or holds something else.
    """
    found = comparison.difference
    with atomic_directory(out, RECORD_FILE) as partial:
        write_field(partial / DIFFERENCE_FILE, found.z_um, comparison.pitch_um, "height difference, um")
        if found.sigma_um is not None:
            write_field(partial / SIGMA_FILE, found.sigma_um, comparison.pitch_um, "standard uncertainty, um")
        write_any_picture(partial / PICTURE_FILE, drawn(comparison))
        (partial / RECORD_FILE).write_bytes(msgspec.json.format(msgspec.json.encode(comparison.record), indent=2))


def drawn(comparison: Comparison) -> Picture:
    """Return the difference in colours, with a ring around each change: picture of shape (rows, columns, 3)."""
    z_um = comparison.difference.z_um
    most_um = float(np.nanquantile(np.abs(z_um), 0.995))
    most_um = max([most_um, 1e-3, *(abs(one.height_um) for one in comparison.record.changes)])
    columns = min(max(z_um.shape[1], MIN_COLUMNS), MAX_COLUMNS)
    still = Still(columns=columns, range_um=(-most_um, most_um), exaggeration=1.0)
    picture = np.ascontiguousarray(render(HeightMap(z_um, comparison.pitch_um), still))
    px_of_um = columns / (z_um.shape[1] * comparison.pitch_um)
    for one in comparison.record.changes:
        middle = (round(one.column_um * px_of_um), round(one.row_um * px_of_um))
        radius_um = max(RING_UM, one.diameter_um)
        cv2.circle(picture, middle, max(round(radius_um * px_of_um), 3), RING_RGB, 2, cv2.LINE_AA)
    return with_strip(picture, (-most_um, most_um))
