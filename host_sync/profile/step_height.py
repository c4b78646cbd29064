"""Step height and groove depth by ISO 5436-1, on a profile across the edges.

Groove or ridge (type A): Z = a X + b + h d is fitted over three times its width, with d = +1 beside it and d = -1 in
its middle third. A third of the width next to each edge is ignored; the depth is 2 h.

Step: the same with one edge and d = +1 and -1 on its sides. A step has no width to decide how much of the profile
is used, so its flank decides: nothing within `GAP_FLANKS` of its length from the edge is used, and `REACH_FLANKS`
beyond. The length of the line has no part in it, once it holds that much.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np

from device.surface import Float64Array, MaskArray
from host_sync.errors import MeasurementError
from host_sync.profile.profile_line import Profile

IGNORED_FRACTION: Final = 1.0 / 3.0
"""Fraction of the groove's width that is ignored at each side of an edge."""

OTHER_FRACTIONS: Final = (0.25, 0.4)
"""Fractions that might be ignored as well: what they change is an uncertainty of the definition."""

GAP_FLANKS: Final = 2.0
"""Length beside the edge that a step ignores, in lengths of its flank: a tenth of the step ends there."""

REACH_FLANKS: Final = 3.0
"""Length of the profile that a step uses at each side, in lengths of its flank."""

SHORTER_FLANK: Final = 0.75
"""A line that is too short cuts the flank short: what a flank of this share changes is an uncertainty too."""

CUT_FLANK: Final = 0.5
"""The same of a flank that goes on where the line ends."""

MAX_CHANGE: Final = 0.2
"""Share of a height from which such a change says that it is not known."""

OTHER_REACHES: Final = (2.0, 4.0)
MIN_FLANK_SAMPLES: Final = 3.0
FLANK_LEVELS: Final = (0.1, 0.9)
"""A flank runs from a tenth to nine tenths of the step."""

MIN_RISE: Final = 1e-3
"""A step's share of the largest height below which the profile's tilt has taken it up."""

MAX_OF_SPAN: Final = 1.1
"""A height over the difference of the profile's extreme heights: a surface that sags beside its edge exceeds 1."""

MIN_EXPLAINED: Final = 0.5
"""Share of the heights' square about a straight line that a found step must explain."""

GIVEN_MARGIN: Final = 2.0
"""A step at given edges leaves no more than so many times what a smooth curve leaves: noise hides a faint step."""

SMOOTH_DEGREE: Final = 3
"""Degree of the smooth curve, which has as many parameters as a step has."""

MIN_SIDE: Final = 0.25
"""A groove has two flanks: the lower is at least this share of the higher, else the profile shows a step."""

MIN_SAMPLES: Final = 3
QUANTILES: Final = (0.02, 0.98)
ROUNDS: Final = 4

StepKind = Literal["groove", "ridge", "step"]


@dataclass(frozen=True, slots=True)
class StepEdges:
    """Edges along the profile, µm; a step has one.

    flank_um : length of a step's flank, µm; 0 where edges were given
    is_cut : whether the flank is longer than the line has room for
    """

    kind: StepKind
    places_um: tuple[float, ...]
    flank_um: float = 0.0
    is_cut: bool = False


def step_height_um(
    profile: Profile, edges: StepEdges, ignored: float = IGNORED_FRACTION, reach: float = REACH_FLANKS
) -> float:
    """Return the height of the step from left to right, or of the ridge above its surroundings.

    A groove has a negative height.

    ignored : fraction of a groove's width that is ignored beside its edges
    reach : how much of the profile a step uses, flanks

    Raises
    ------
    MeasurementError
        There are too few valid samples beside an edge.
    """
    return float(_fitted(profile, edges, ignored, reach)[2])


def definition_sigma_um(profile: Profile, edges: StepEdges) -> float:
    """Return the standard uncertainty of the height that comes from its definition.

    It is the spread of the height over how much of the profile is used and, on a line that is too short, the change of
    the height with the flank that is left out. NaN where the line ends so far within the flank that the step's levels
    are not known.
    """
    found = [step_height_um(profile, edges)]
    room = room_share(profile, edges)  # a line that is too short varies what it has
    for ignored, reach in zip(OTHER_FRACTIONS, OTHER_REACHES, strict=True):
        try:
            found.append(step_height_um(profile, edges, ignored, min(room, 1.0) * reach))
        except MeasurementError:
            continue
    still = 0.0
    if room < 1.0 or edges.is_cut:
        shorter = CUT_FLANK if edges.is_cut else SHORTER_FLANK
        try:
            still = found[0] - step_height_um(profile, replace(edges, flank_um=shorter * edges.flank_um))
        except MeasurementError:
            return float("nan")
        if abs(still) > MAX_CHANGE * abs(found[0]):
            return float("nan")
    return float(np.hypot(np.std(found), still))


def require_step(profile: Profile, edges: StepEdges, *, are_found: bool) -> None:
    """Refuse a fit that shows no step: one higher than the profile, or one that describes it worse than a smooth curve.

    are_found : whether `find_edges` found the edges; given edges may lie at a step that is fainter than the roughness

    Raises
    ------
    MeasurementError
        The profile shows no step.
    """
    height = step_height_um(profile, edges)
    used = used_samples(profile, edges)
    sides = _sides(profile, edges, IGNORED_FRACTION, REACH_FLANKS)[used]
    along, z_um = profile.along_um[used], profile.z_um[used]
    place = (along - along.mean()) / np.ptp(along)
    line, smooth = (_rest(np.vander(place, degree + 1), z_um) for degree in (1, SMOOTH_DEGREE))
    left = _rest(np.stack([np.ones_like(place), place, sides], axis=-1), z_um)
    known = profile.z_um[np.isfinite(profile.z_um)]
    rounding = np.finfo(np.float32).eps * float(np.abs(known).max())
    is_there = rounding < abs(height) <= MAX_OF_SPAN * float(np.ptp(known))
    if are_found:
        is_there = is_there and left <= min(smooth, (1.0 - MIN_EXPLAINED) * line) + float(used.sum()) * rounding**2
    else:
        is_there = is_there and left <= GIVEN_MARGIN * smooth + float(used.sum()) * rounding**2
    if is_there and edges.kind != "step":
        beyond = np.where((sides < 0.0) & (along > edges.places_um[1]), 1.0, 0.0)
        design = np.stack([np.ones_like(place), place, (sides > 0.0).astype(np.float64), beyond], axis=-1)
        first, other = np.linalg.lstsq(design, z_um, rcond=None)[0][2:]
        flanks = sorted((first, first - other), key=abs)
        is_there = bool(flanks[0] * flanks[1] >= MIN_SIDE * flanks[1] ** 2)
    if not is_there:
        where, instead = ("", "its") if are_found else (" at the given edges", "other")
        raise MeasurementError(
            f"the profile shows no {edges.kind}{where}: draw the line across one, or give {instead} edges"
        )
    if np.isnan(definition_sigma_um(profile, edges)):
        raise MeasurementError(
            f"the line ends within the flank at {edges.places_um[0]:.0f} µm, so that the step's two levels are not "
            "known: lengthen it on both sides"
        )


def _rest(design: Float64Array, z_um: Float64Array) -> float:
    """Return the sum of the squares that a least-squares fit leaves, µm²."""
    return float(np.square(z_um - design @ np.linalg.lstsq(design, z_um, rcond=None)[0]).sum())


def lines_um(profile: Profile, edges: StepEdges) -> tuple[Float64Array, Float64Array]:
    """Return both fitted lines at every sample, µm: beside the groove and in it, or right and left of the step."""
    slope, middle, height = _fitted(profile, edges, IGNORED_FRACTION, REACH_FLANKS)
    base = slope * profile.along_um + middle
    return base - 0.5 * height, base + 0.5 * height


def used_samples(profile: Profile, edges: StepEdges) -> MaskArray:
    """Return samples that the lines are fitted to: bool array of shape (N,)."""
    return np.asarray((_sides(profile, edges, IGNORED_FRACTION, REACH_FLANKS) != 0) & np.isfinite(profile.z_um))


def room_share(profile: Profile, edges: StepEdges) -> float:
    """Return the fraction of the profile a step should use that the line holds; 1 for grooves and given edges."""
    if edges.kind != "step" or not edges.flank_um:
        return 1.0
    edge = edges.places_um[0]
    room = min(edge, float(profile.along_um[-1]) - edge) - GAP_FLANKS * edges.flank_um
    return min(1.0, max(0.0, room / (REACH_FLANKS * edges.flank_um)))


def _fitted(profile: Profile, edges: StepEdges, ignored: float, reach: float) -> tuple[float, float, float]:
    """Return the slope, height of the middle at the start, and height between both lines; µm/µm, µm, µm."""
    sides = _sides(profile, edges, ignored, reach)
    valid = np.isfinite(profile.z_um)
    upper, lower = valid & (sides > 0), valid & (sides < 0)
    for part in (upper, lower):
        if part.sum() < MIN_SAMPLES:
            raise MeasurementError(
                f"the {edges.kind}'s edges at {', '.join(f'{place:.0f}' for place in edges.places_um)} µm leave fewer "
                f"than {MIN_SAMPLES} valid samples on one side: lengthen the line or give other edges"
            )
    used = upper | lower
    along = profile.along_um[used]
    centre = float(along.mean())
    delta = np.where(upper[used], 1.0, -1.0)
    design = np.stack([along - centre, np.ones_like(along), delta], axis=-1)
    slope, middle, half = (float(value) for value in np.linalg.lstsq(design, profile.z_um[used], rcond=None)[0])
    return slope, middle - slope * centre, 2.0 * half


def find_edges(profile: Profile, kind: StepKind) -> StepEdges:
    """Return the edges, where the profile crosses half way between its two levels.

    Raises
    ------
    MeasurementError
        The profile shows no edge, or a ridge where a groove is asked for.
    """
    along, z_um = profile.along_um, profile.z_um
    valid = np.isfinite(z_um)
    if valid.sum() < 4 * MIN_SAMPLES:
        raise MeasurementError(f"a {kind} needs more than {4 * MIN_SAMPLES} valid samples: lengthen the line")
    if kind == "step":
        return _refined_step(profile, _best_edge(along[valid], z_um[valid]))
    ends = valid & ((along < 0.1 * along[-1]) | (along > 0.9 * along[-1]))
    tilt = np.polyfit(along[ends], z_um[ends], 1) if ends.sum() > MIN_SAMPLES else np.zeros(2)
    level = z_um - np.polyval(tilt, along)
    level = np.interp(along, along[valid], level[valid])
    low, high = np.quantile(level, QUANTILES)
    if kind == "ridge" and high <= 0.0:
        raise MeasurementError("the profile shows no ridge: draw the line across it, or give its edges")
    sinks = -low > high and kind == "groove"
    inside = level < low / 2.0 if sinks else level > high / 2.0
    first, last = _longest_run(inside, kind)
    rough = StepEdges(kind, (float(along[first]) - profile.step_um / 2.0, float(along[last]) + profile.step_um / 2.0))
    return _refined_groove(profile, rough)


def _refined_groove(profile: Profile, rough: StepEdges) -> StepEdges:
    """Return edges where the profile crosses half way between the lines that are fitted beside and in the groove."""
    edges = rough
    for _ in range(ROUNDS):
        try:
            beside, inner = lines_um(profile, edges)
        except MeasurementError:
            return rough
        height = inner - beside
        share = (profile.z_um - beside) / np.where(np.abs(height) > 0.0, height, np.inf)
        places = tuple(_crossing(profile, share, place, 0.5) for place in edges.places_um)
        if any(place is None for place in places):
            return rough
        edges = StepEdges(rough.kind, tuple(place for place in places if place is not None))
        if edges.places_um[1] - edges.places_um[0] < MIN_SAMPLES * profile.step_um:
            return rough
    return edges


def _refined_step(profile: Profile, edge_um: float) -> StepEdges:
    """Return the edge where the profile crosses half way, with the length of its flank.

    Neither depends on the line's length.
    """
    length = float(profile.along_um[-1])
    flank = min(0.1 * length, min(edge_um, length - edge_um) / (2.0 * GAP_FLANKS))
    is_cut = False
    for _ in range(2 * ROUNDS):
        edges = StepEdges("step", (edge_um,), flank)
        try:
            low, high = lines_um(profile, edges)
        except MeasurementError:
            break
        rise = high - low
        if np.abs(rise).max() <= MIN_RISE * float(np.nanmax(np.abs(profile.z_um))):
            is_cut = True
            break
        share = (profile.z_um - low) / rise
        found = [_crossing(profile, share, edge_um, level) for level in (FLANK_LEVELS[0], 0.5, FLANK_LEVELS[1])]
        first, middle, last = found
        if first is None or middle is None or last is None:
            break
        shortest = MIN_FLANK_SAMPLES * profile.step_um
        longest = max(min(0.125 * length, min(middle, length - middle) / (GAP_FLANKS + 1.0)), shortest)
        is_cut = abs(last - first) > longest
        wanted = float(np.clip(abs(last - first), shortest, longest))
        settled = abs(middle - edge_um) + abs(wanted - flank) < 0.02 * profile.step_um
        edge_um, flank = middle, wanted
        if settled:
            break
    return StepEdges("step", (edge_um,), flank, is_cut)


def _crossing(profile: Profile, share: Float64Array, near_um: float, level: float) -> float | None:
    """Place nearest to `near_um` where `share` crosses a level, µm; None where it does not."""
    above = share > level
    known = np.isfinite(share[1:]) & np.isfinite(share[:-1])
    at = np.flatnonzero((above[1:] != above[:-1]) & known)
    if not at.size:
        return None
    part = (level - share[at]) / (share[at + 1] - share[at])
    places = (at + part) * profile.step_um
    return float(places[int(np.abs(places - near_um).argmin())])


def _sides(profile: Profile, edges: StepEdges, ignored: float, reach: float) -> Float64Array:
    """1 for samples of the upper side (right of a step), -1 for the other level, 0 for ignored ones."""
    along = profile.along_um
    if edges.kind == "step":
        edge = edges.places_um[0]
        beyond = along - edge
        gap, end = ignored * min(edge - along[0], along[-1] - edge), np.inf
        if edges.flank_um:
            gap, end = GAP_FLANKS * edges.flank_um, (GAP_FLANKS + reach) * edges.flank_um
        return np.where((np.abs(beyond) > gap) & (np.abs(beyond) <= end), np.sign(beyond), 0.0)
    left, right = edges.places_um
    width = right - left
    middle = np.abs(along - (left + right) / 2.0)
    # Signs as for a step: heights above the reference are positive.
    inside = middle < width * (0.5 - ignored)
    beside = (middle > width * (0.5 + ignored)) & (middle < 1.5 * width)
    return np.where(inside, 1.0, np.where(beside, -1.0, 0.0))


def _best_edge(along: Float64Array, z_um: Float64Array) -> float:
    """Return the position that splits the profile into two levels of equal tilt with the smallest residual."""
    candidates = np.linspace(0.15, 0.85, 141) * (along[-1] - along[0]) + along[0]
    residuals = []
    for edge in candidates:
        design = np.stack([along, np.ones_like(along), (along > edge).astype(np.float64)], axis=-1)
        solution = np.linalg.lstsq(design, z_um, rcond=None)[0]
        residuals.append(float(((z_um - design @ solution) ** 2).sum()))
    return float(candidates[int(np.argmin(residuals))])


def _longest_run(inside: MaskArray, kind: StepKind) -> tuple[int, int]:
    """Return the first and last index of the longest true run."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], inside.astype(int), [0]])))
    if not edges.size:
        raise MeasurementError(f"the profile shows no {kind}: draw the line across it, or give its edges")
    starts, ends = edges[::2], edges[1::2]
    longest = int((ends - starts).argmax())
    return int(starts[longest]), int(ends[longest]) - 1
