"""The level of every press: one plane each, so that presses agree where they overlap, all together by least squares.

A press's own zero says nothing of the object: it is that of the skin around it, or none. So only differences count, and
the height and tilt of the whole stay as the presses have them in the mean.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from device.align import Pose
from device.surface import Float64Array
from host_sync.mosaic.presses import Small
from host_sync.registration.resampling import moved

BLOCKS: Final = 24
"""Blocks along the longer side of a press whose median differences are compared."""

FILLED: Final = 0.5
"""Least part of a block that both presses have."""

INDEPENDENT: Final = 9.0
"""An overlap counts as at most so many independent heights: errors of a press are long waves."""

MIN_SIGMA_UM: Final = 1e-3
ROUNDS: Final = 6
TUKEY: Final = 4.685
GAUGE: Final = 3
"""Height and two tilts of the whole, which no difference shows."""


@dataclass(frozen=True, slots=True, eq=False)
class Meeting:
    """Difference of two presses over their overlap, block by block.

    first, second : numbers of the presses
    here, there : float64 arrays of shape (N, 2), the blocks' middles in either press, px from its middle
    apart_um : float64 array of shape (N,), second less first
    sigma_um : float64 array of shape (N,), combined standard uncertainty of both heights there
    """

    first: int
    second: int
    here: Float64Array
    there: Float64Array
    apart_um: Float64Array
    sigma_um: Float64Array


@dataclass(frozen=True, slots=True, eq=False)
class Levels:
    """Planes that are added to the presses.

    planes : float64 array of shape (N, 3), height (µm) and slopes (µm per px, rows and columns) about the middles
    covariance : float64 array of shape (N, 3, 3) of each plane
    """

    planes: Float64Array
    covariance: Float64Array

    def apart_um(self, meeting: Meeting) -> Float64Array:
        """Return what still lies between two presses: float64 array of shape (blocks,)."""
        one, other = (self.planes[press] for press in (meeting.first, meeting.second))
        return np.asarray(
            meeting.apart_um + other[0] + meeting.there @ other[1:] - one[0] - meeting.here @ one[1:], np.float64
        )


def meeting(presses: list[Small], first: int, second: int, pose: Pose) -> Meeting:
    """Return the differences of two presses; pose: from the first to the second."""
    one, other = presses[first], presses[second]
    rows, columns = one.z_um.shape
    cells = one.in_cells(other, pose)
    apart = moved(other.z_um, cells, one.z_um.shape, 1) - one.z_um
    sigma = np.hypot(moved(other.sigma_um, cells, one.z_um.shape, 1), one.sigma_um)
    size = max(1, -(-max(rows, columns) // BLOCKS))
    places, values, sigmas = [], [], []
    for row in range(0, rows - size + 1, size):
        for column in range(0, columns - size + 1, size):
            block = apart[row : row + size, column : column + size]
            known = np.isfinite(block)
            if known.mean() < FILLED:
                continue
            places.append(one.centred((row + 0.5 * (size - 1), column + 0.5 * (size - 1))))
            values.append(float(np.median(block[known])))
            sigmas.append(float(np.nanmean(sigma[row : row + size, column : column + size])))
    here = np.array(places, np.float64).reshape(-1, 2)
    return Meeting(first, second, here, pose.of(here), np.array(values), _known(np.array(sigmas)))


def levelled(meetings: list[Meeting], presses: int, reach_px: float) -> Levels:
    """Return the planes of all presses.

    meetings : of the links in use; together they join the presses that have a place
    reach_px : half the diagonal of a press, to which tilts are scaled
    """
    count = 3 * presses
    solution, covariance = np.zeros(count), np.zeros((count, count))
    weights = [np.ones(len(one.apart_um)) for one in meetings]
    for _ in range(ROUNDS):
        normal, right = np.zeros((count, count)), np.zeros(count)
        chi, equations = 0.0, 0.0
        for one, weight in zip(meetings, weights, strict=True):
            design, columns = _design(one, reach_px)
            share = min(1.0, INDEPENDENT / max(len(weight), 1))
            trust = share * weight / one.sigma_um**2
            normal[np.ix_(columns, columns)] += design.T @ (trust[:, None] * design)
            right[columns] -= design.T @ (trust * one.apart_um)
            chi += float(trust @ (one.apart_um + design @ solution[columns]) ** 2)
            equations += share * float(weight.sum())
        inverse = _inverse(normal)
        solution = inverse @ right
        weights = [_tukey(_rest(one, solution, reach_px) / one.sigma_um) for one in meetings]
        covariance = inverse * max(chi / max(equations - count + GAUGE, 1.0), 1.0)
    scale = np.tile([1.0, 1.0 / reach_px, 1.0 / reach_px], presses)
    planes = (solution * scale).reshape(presses, 3)
    full = covariance * np.outer(scale, scale)
    blocks = np.stack([full[3 * one : 3 * one + 3, 3 * one : 3 * one + 3] for one in range(presses)])
    return Levels(planes, blocks)


def _design(one: Meeting, reach_px: float) -> tuple[Float64Array, list[int]]:
    """Return equations of a meeting, and the columns of the six unknowns that they are about."""
    ones = np.ones((len(one.apart_um), 1))
    design = np.hstack([-ones, -one.here / reach_px, ones, one.there / reach_px])
    return design, [*range(3 * one.first, 3 * one.first + 3), *range(3 * one.second, 3 * one.second + 3)]


def _rest(one: Meeting, solution: Float64Array, reach_px: float) -> Float64Array:
    design, columns = _design(one, reach_px)
    return np.asarray(one.apart_um + design @ solution[columns], np.float64)


def _tukey(off: Float64Array) -> Float64Array:
    """Return weights of residuals (in σ): 0 where they are no noise."""
    spread = TUKEY * max(1.4826 * float(np.median(np.abs(off))) if off.size else 1.0, 0.1)
    return np.asarray(np.clip(1.0 - (off / spread) ** 2, 0.0, None) ** 2, np.float64)


def _inverse(normal: Float64Array) -> Float64Array:
    """Return the inverse without the directions that no difference shows."""
    values, vectors = np.linalg.eigh(normal)
    determined = values > 1e-9 * max(float(values[-1]), 1e-30)
    determined[: min(GAUGE, len(determined))] = False
    turned = vectors[:, determined]
    return np.asarray((turned / values[determined]) @ turned.T, np.float64)


def _known(sigma_um: Float64Array) -> Float64Array:
    """Uncertainties, 1 µm where no press states any."""
    if not sigma_um.size or not (sigma_um > 0.0).any():
        return np.ones(sigma_um.shape)
    return np.maximum(sigma_um, MIN_SIGMA_UM)
