"""Step height and groove depth by ISO 5436-1, on a profile across the edges.

Groove or ridge (type A): Z = a X + b + h d is fitted over three times its width, with d = +1 beside it and d = -1 in
its middle third. A third of the width next to each edge is ignored; the depth is 2 h. Step: the same with one edge and
d = +1 and -1 on its sides.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from device.surface.fields import Float64Array, MaskArray
from host_sync.errors import MeasurementError
from host_sync.profile.profile_line import Profile

IGNORED_SHARE: Final = 1.0 / 3.0
"""Fraction of the groove's width that is ignored at each side of an edge."""

MIN_SAMPLES: Final = 3
QUANTILES: Final = (0.02, 0.98)

StepKind = Literal["groove", "step"]


@dataclass(frozen=True, slots=True)
class StepEdges:
    """Positions of the edges along the profile, µm; a step has one."""

    kind: StepKind
    places_um: tuple[float, ...]


def step_height_um(profile: Profile, edges: StepEdges) -> float:
    """Height of the step from left to right, or of the ridge above its surroundings (negative for a groove), µm.

    Raises
    ------
    MeasurementError
        There are too few valid samples beside an edge.
    """
    sides = _sides(profile, edges)
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
    along = along - along.mean()
    delta = np.where(upper[used], 1.0, -1.0)
    design = np.stack([along, np.ones_like(along), delta], axis=-1)
    return 2.0 * float(np.linalg.lstsq(design, profile.z_um[used], rcond=None)[0][2])


def find_edges(profile: Profile, kind: StepKind) -> StepEdges:
    """The edges, where the profile crosses half way between its two levels.

    Raises
    ------
    MeasurementError
        The profile shows no edge.
    """
    along, z_um = profile.along_um, profile.z_um
    valid = np.isfinite(z_um)
    if valid.sum() < 4 * MIN_SAMPLES:
        raise MeasurementError(f"a {kind} needs more than {4 * MIN_SAMPLES} valid samples: lengthen the line")
    if kind == "step":
        return StepEdges(kind, (_best_edge(along[valid], z_um[valid]),))
    ends = valid & ((along < 0.1 * along[-1]) | (along > 0.9 * along[-1]))
    tilt = np.polyfit(along[ends], z_um[ends], 1) if ends.sum() > MIN_SAMPLES else np.zeros(2)
    level = z_um - np.polyval(tilt, along)
    level = np.interp(along, along[valid], level[valid])
    low, high = np.quantile(level, QUANTILES)
    inside = level < low / 2.0 if -low > high else level > high / 2.0
    first, last = _longest_run(inside)
    return StepEdges(kind, (float(along[first]) - profile.step_um / 2.0, float(along[last]) + profile.step_um / 2.0))


def _sides(profile: Profile, edges: StepEdges) -> Float64Array:
    """1 for samples of the upper side (right of a step), -1 for the other level, 0 for ignored ones."""
    along = profile.along_um
    if edges.kind == "step":
        edge = edges.places_um[0]
        ignored = IGNORED_SHARE * min(edge - along[0], along[-1] - edge)
        return np.where(along > edge + ignored, 1.0, np.where(along < edge - ignored, -1.0, 0.0))
    left, right = edges.places_um
    width = right - left
    middle = np.abs(along - (left + right) / 2.0)
    # Signs as for a step: heights above the reference are positive.
    inside = middle < width * (0.5 - IGNORED_SHARE)
    beside = (middle > width * (0.5 + IGNORED_SHARE)) & (middle < 1.5 * width)
    return np.where(inside, 1.0, np.where(beside, -1.0, 0.0))


def _best_edge(along: Float64Array, z_um: Float64Array) -> float:
    """Position that splits the profile into two levels of equal tilt with the smallest residual."""
    candidates = np.linspace(0.15, 0.85, 141) * (along[-1] - along[0]) + along[0]
    residuals = []
    for edge in candidates:
        design = np.stack([along, np.ones_like(along), (along > edge).astype(np.float64)], axis=-1)
        solution = np.linalg.lstsq(design, z_um, rcond=None)[0]
        residuals.append(float(((z_um - design @ solution) ** 2).sum()))
    return float(candidates[int(np.argmin(residuals))])


def _longest_run(inside: MaskArray) -> tuple[int, int]:
    """First and last index of the longest true run."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], inside.astype(int), [0]])))
    if not edges.size:
        raise MeasurementError("the profile shows no groove: draw the line across it, or give its edges")
    starts, ends = edges[::2], edges[1::2]
    longest = int((ends - starts).argmax())
    return int(starts[longest]), int(ends[longest]) - 1
