"""Links: the place of one press relative to another by their slopes, fitted over their overlap and judged.

Candidates are places of strongly reduced presses in each other, ranked. The fit and its uncertainty are those of the
registration of two presses. Both presses are cut to where they overlap.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from device.align import PlaceSearch, Pose, relief_slopes, turning
from device.surface import Float32Array, Float64Array
from host_sync.csv_table import number_in, read_table
from host_sync.errors import MosaicError
from host_sync.mosaic.presses import Press, Small
from host_sync.registration.fit import Fit, Pair, coherence, fit, moved, reduced
from host_sync.registration.register import MIN_AGREEMENT, MIN_COHERENCE

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


ROUGH_PX: Final = 96
ROUGH_SIDE_PX: Final = 40
"""Size of the pieces for a first fit: about so many px along their longer side, and no fewer along the shorter."""

MARGIN: Final = 0.06
"""Cut beyond the overlap, as a fraction of the field: a candidate is that far off."""

MIN_SIDE_PX: Final = 20
MIN_FRACTION: Final = 0.04
"""Least overlap, as a fraction of the field."""

PATIENCE: Final = 5
"""Candidates of a press that fail one after the other before it counts as fully linked."""

APART_PX: Final = 8.0
"""Places of one pair closer than this are one, px of a press."""

RIVAL: Final = 1.5
"""Another place of the same presses competes unless its residual is larger by this factor."""

UNLIKE: Final = 2.0
"""A link is refused whose residual is larger, by this factor, than that of the better links of the mosaic."""

RIVALLED: Final = "they agree about as well at another place: a pattern repeats"

MAX_SIGMA_PX: Final = 0.5
"""Largest standard uncertainty of a link's place, px of the reduced presses."""


@dataclass(frozen=True, slots=True, eq=False)
class Link:
    """Place of one press in another.

    first, second : numbers of the presses
    here, there : float64 arrays of shape (2,), the middle of the overlap in the first, and where it lies in the second;
        px from the middle of each
    turn : of the object in the second, rad
    covariance : float64 array of shape (3, 3) of `there` (px) and `turn` (rad)
    agreement : correlation of the slopes over the overlap
    overlap_share : overlap as a fraction of the first press
    residual : mean squared slope difference over a tile, the median of all tiles
    stretch : by how much the second is larger than the first, relative; NaN if the overlap does not show it
    refused : why it is no link, one clause; empty when it may be one
    """

    first: int
    second: int
    here: Float64Array
    there: Float64Array
    turn: float
    covariance: Float64Array
    agreement: float
    overlap_share: float
    residual: float = 0.0
    stretch: float = float("nan")
    refused: str = ""

    @property
    def pose(self) -> Pose:
        """From the first to the second."""
        away = self.there - turning(self.turn) @ self.here
        return Pose(float(away[0]), float(away[1]), self.turn)

    @property
    def sigma_px(self) -> float:
        """Standard uncertainty of its place along the direction that is known least, px."""
        return float(np.sqrt(max(np.linalg.eigvalsh(self.covariance[:2, :2])[-1], 0.0)))

    @property
    def strength(self) -> float:
        """Return what it weighs where links contradict each other."""
        return self.agreement * float(np.sqrt(self.overlap_share))


def verified(
    presses: list[Small], wanted: list[Candidate], report_progress: Callable[[int], None] = lambda _: None
) -> list[Link]:
    """Return the links that candidates lead to, refused ones too.

    wanted : best first; a press whose last candidates all failed is not looked at again for another such press
    """
    failures = np.zeros(len(presses), int)
    found = []
    for number, candidate in enumerate(wanted):
        report_progress(number + 1)
        pair = [candidate.first, candidate.second]
        if failures[pair].min() >= PATIENCE:
            continue
        link = linked(presses, candidate)
        if link is not None:
            found.append(link)
        accepted = link is not None and not link.refused
        failures[pair] = 0 if accepted else failures[pair] + 1
    return _without_rivals(found)


def _without_rivals(found: list[Link]) -> list[Link]:
    """Return the links, each place of a pair once, with those refused that are ambiguous or poor.

    A link is ambiguous if another place of the same presses rivals it, and poor if it agrees less than links here do.
    """
    pairs: dict[tuple[int, int], list[Link]] = {}
    for link in found:
        if not link.refused:
            pairs.setdefault((link.first, link.second), []).append(link)
    kept: dict[int, str] = {}
    copies: set[int] = set()
    for links in pairs.values():
        best = min(links, key=lambda one: one.residual)
        others = [one for one in links if float(np.hypot(*(one.pose.of(best.here) - best.there))) > APART_PX]
        copies |= {id(one) for one in links if one is not best and one not in others}
        rivals = [one for one in others if one.residual < RIVAL * best.residual]
        kept |= {id(one): RIVALLED for one in (best, *rivals) if rivals}
        kept |= {id(one): "the presses agree better at another place" for one in others if not rivals}
    usual = [link.residual for link in found if not link.refused and id(link) not in kept]
    limit = UNLIKE * float(np.quantile(usual, 0.25)) if usual else np.inf
    for link in found:
        if not link.refused and id(link) not in kept and link.residual > limit:
            kept[id(link)] = "their slopes differ by more than those of other presses here"
    apart = [link for link in found if id(link) not in copies]
    return [replace(link, refused=kept[id(link)]) if id(link) in kept else link for link in apart]


def linked(presses: list[Small], candidate: Candidate) -> Link | None:
    """Return the link that a candidate leads to, refused or not; None where the presses hardly overlap there."""
    one, other = presses[candidate.first], presses[candidate.second]
    start = candidate.pose
    boxes = _boxes(one, other, start)
    if boxes is None:
        return None
    first, second = (_piece(press, box) for press, box in zip((one, other), boxes, strict=True))
    # The pose of the cut pieces counts from the middle of the first piece, in px of the reduced press.
    middle = 0.5 * (np.array(first.shape) - 1.0)
    here, base = (press.centred(box[:2] + middle) for press, box in zip((one, other), boxes, strict=True))
    found = _fitted(first, second, Pose(turn=start.turn).moved_by(*(start.of(here) - base) / one.step))
    if found is None:
        return None
    pair = Pair.of(first, second, max(first.shape))
    scale = np.array([one.step, one.step, 1.0])
    return Link(
        candidate.first,
        candidate.second,
        here,
        base + one.step * np.array([found.pose.down, found.pose.right]),
        found.pose.turn,
        found.covariance * np.outer(scale, scale),
        found.agreement,
        float(found.common.sum()) / one.z_um.size,
        float(np.nanmedian(found.residual)),
        _stretch(pair, found),
        _refusal(found, pair, one),
    )


def _refusal(found: Fit, pair: Pair, one: Small) -> str:
    """Return why a fit is no link; empty when it is one."""
    if float(found.common.sum()) < MIN_FRACTION * one.z_um.size:
        return "they hardly overlap there"
    if found.agreement < MIN_AGREEMENT:
        return f"their slopes agree by only {100.0 * max(found.agreement, 0.0):.0f} %"
    if not np.isfinite(found.covariance).all() or not found.sigma_px <= MAX_SIGMA_PX:
        return "the overlap does not determine the shift"
    if coherence(pair, found.pose) < MIN_COHERENCE:
        return "the shift along one direction is not seen"
    return ""


def _fitted(first: Float32Array, second: Float32Array, pose: Pose) -> Fit | None:
    """Return the fit from a pose, coarsely and then finely."""
    step = min(-(-max(first.shape) // ROUGH_PX), min(*first.shape, *second.shape) // ROUGH_SIDE_PX)
    if step > 1:
        near = fit(Pair.of(first, second, -(-max(first.shape) // step)), pose)
        if near is None or near.agreement < 0.5 * MIN_AGREEMENT:
            return near
        pose = near.pose
    return fit(Pair.of(first, second, max(first.shape)), pose)


Box = tuple[int, int, int, int]
"""First row, first column, end of rows, end of columns."""


def _boxes(one: Small, other: Small, pose: Pose) -> tuple[Box, Box] | None:
    """Return the boxes of both reduced presses around their overlap; None if it is small."""
    shapes = one.z_um.shape, other.z_um.shape
    margin = round(MARGIN * max(shapes[0]))
    here = _box(other.in_cells(one, pose.back()), shapes[1], shapes[0], margin, (0, 0, *shapes[1]))
    there = here and _box(one.in_cells(other, pose), *shapes, 2 * margin, here)
    return (here, there) if here and there else None


def _piece(press: Small, box: Box) -> Float32Array:
    """Return a piece of a press with an invalid border, which keeps smoothing from making slopes there."""
    piece = press.z_um[box[0] : box[2], box[1] : box[3]].copy()
    piece[[0, -1]] = np.nan
    piece[:, [0, -1]] = np.nan
    return piece


def _box(pose: Pose, start: tuple[int, ...], shape: tuple[int, ...], margin: int, box: Box) -> Box | None:
    """Return the box of a map of `shape` that a box of a map of `start` covers; None if it is small."""
    rows, columns = (box[0], box[2] - 1), (box[1], box[3] - 1)
    corners = np.array([(row, column) for row in rows for column in columns], np.float64)
    places = pose.of(corners - 0.5 * (np.array(start[:2]) - 1)) + 0.5 * (np.array(shape[:2]) - 1)
    low = np.maximum(np.floor(places.min(axis=0)).astype(int) - margin, 0)
    high = np.minimum(np.ceil(places.max(axis=0)).astype(int) + margin + 1, shape[:2])
    if (high - low).min() < MIN_SIDE_PX:
        return None
    return int(low[0]), int(low[1]), int(high[0]), int(high[1])


def _stretch(pair: Pair, found: Fit) -> float:
    """Return the relative stretch of the second piece over the first, fitted to slopes together with the pose."""
    seen = moved(pair.second, found.pose, pair.first.shape, pair.step)
    row, column = np.meshgrid(*(np.arange(size) - 0.5 * (size - 1) for size in seen.shape), indexing="ij")
    q, p = (0.5 * (one + other) for one, other in zip(np.gradient(seen), np.gradient(pair.first), strict=True))
    rests = np.gradient(pair.first - seen)
    normal, right = np.zeros((8, 8)), np.zeros(8)
    for number, (slope, turned, rest) in enumerate(((q, p, rests[0]), (p, -q, rests[1]))):
        down, across = np.gradient(slope)
        tilts = [np.full(slope.shape, float(number == axis)) for axis in (0, 1)]
        turn = down * column - across * row + turned
        stretch = row * down + column * across + slope
        # Interpolation takes of the finest slopes, and a press of another depth has a gain of its own.
        blunter = np.gradient(down)[0] + np.gradient(across)[1]
        design = np.stack([*tilts, down, across, turn, slope, blunter, stretch], axis=-1)
        known = np.isfinite(design).all(axis=-1) & np.isfinite(rest)
        part = design[known]
        normal += part.T @ part
        right += part.T @ rest[known]
    scale = np.sqrt(np.diag(normal))
    if not (scale > 0.0).all():
        return float("nan")
    solved = np.linalg.lstsq(normal / np.outer(scale, scale), right / scale, rcond=None)[0]
    return float(solved[-1] / scale[-1])
