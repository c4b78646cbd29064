"""Candidates for overlaps: places of strongly reduced presses in each other, ranked, which `links` verifies."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from device.align import PlaceSearch, Pose, relief_slopes
from device.surface import Float64Array
from host_sync.csv_table import number_in, read_table
from host_sync.errors import MosaicError
from host_sync.mosaic.presses import Press, Small
from host_sync.registration.resampling import reduced

COARSE_PX: Final = 128
TURNS_DEG: Final = tuple(range(-12, 13, 2))
MIN_OVERLAP: Final = 0.07
"""Least overlap that is looked for, as a fraction of the field."""

PEAKS: Final = 4
"""Places of one pair that are verified."""

PARTNERS: Final = 16
"""Presses that one press is verified with, at most: the best ranked."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """Possible place of a press in another.

    first, second : numbers of the presses
    pose : from the first to the second, px of a press
    rank : height of the peak over the noise
    """

    first: int
    second: int
    pose: Pose
    rank: float


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """Stated places of presses.

    places_px : float64 array of shape (N, 2), their middles (row, column)
    within_px : how far off that may be
    """

    places_px: Float64Array
    within_px: float


def candidates(presses: list[Small], layout: Layout | None = None) -> list[Candidate]:
    """Return what is worth verifying, best first."""
    step = -(-max(max(press.z_um.shape) for press in presses) // COARSE_PX)
    px = step * presses[0].step
    coarse = [relief_slopes(reduced(press.z_um, step))[0] for press in presses]
    search = PlaceSearch(coarse[0].shape, TURNS_DEG, MIN_OVERLAP)
    spectra = [search.first(slopes) for slopes in coarse]
    found: list[Candidate] = []
    for second, slopes in enumerate(coarse):
        turned = search.second(slopes)
        for first in range(second):
            near = None
            if layout is not None:
                expected = (layout.places_px[first] - layout.places_px[second]) / px
                near = expected, layout.within_px / px + 1.0
            found += [
                Candidate(first, second, place.pose.in_units_of(1.0 / px), place.rank)
                for place in search.places(spectra[first], turned, PEAKS, near)
            ]
    return _chosen(found, len(presses))


def _chosen(found: list[Candidate], count: int) -> list[Candidate]:
    """Return the best ranked, best first, so that no press is verified with too many."""
    seen = np.zeros(count, int)
    chosen = []
    for one in sorted(found, key=lambda one: -one.rank):
        if min(seen[one.first], seen[one.second]) < PARTNERS:
            seen[[one.first, one.second]] += 1
            chosen.append(one)
    return chosen


COLUMNS: Final = ("scan", "right_mm", "down_mm")


def read_layout(path: Path, presses: list[Press], within_mm: float) -> Layout:
    """Return the layout of the presses.

    within_mm : how far off it may be

    Raises
    ------
    MosaicError
        The file cannot be read, or does not hold every press.
    """
    if not within_mm > 0.0:
        raise MosaicError(f"--within-mm {within_mm:g}: is no length: give a positive number")
    places = {}
    for number, row in enumerate(read_table(path, MosaicError), start=2):
        place = [number_in(row.get(name, "")) for name in COLUMNS[1:]]
        if "scan" not in row or not np.isfinite(place).all():
            raise MosaicError(f"{path}: line {number}: needs {', '.join(COLUMNS)}, the last two finite numbers")
        places[row["scan"]] = place[::-1]
    missing = [press.name for press in presses if press.name not in places]
    if missing:
        raise MosaicError(f"{path}: holds no line for {missing[0]}: add one for each scan")
    per_mm = 1e3 / presses[0].record.pixel_pitch_um
    return Layout(np.array([places[press.name] for press in presses], np.float64) * per_mm, within_mm * per_mm)
