"""Place on a square lattice of each ball of a grid, whatever is missing, false, turned or in perspective.

A lattice is grown from one ball and two of its neighbours: where a neighbour's neighbour is expected, the nearest ball
is taken and corrects the expectation, so that perspective and distortion are followed. A homography then reaches over
gaps. Of all lattices grown the one wins that explains the most balls and leaves the fewest of its places empty.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from device.surface import Float64Array, MaskArray

MIN_BALLS: Final = 6
"""Fewer balls fit one lattice or another by chance."""

PERSPECTIVE_BALLS: Final = 10
"""Fewer balls are laid on a lattice without perspective, which must be a clear one: chance makes the others."""

STEEPEST: Final = 40.0
"""Ratio of the areas that one cell fills at the near and the far end of a lattice in the strongest perspective."""

SEEDS: Final = 16
NEIGHBOURS: Final = 6
GROWTH: Final = 0.25
"""A neighbour is where it is expected to this share of a step."""

ON_LATTICE: Final = 0.15
"""Largest share of a step by which a ball of the lattice strays from its place."""

OUTLIER: Final = 6.0
"""A ball this many standard deviations (of the others) from its place is not of the lattice."""

MIN_STRAY: Final = 0.03
"""A ball this share of a step from its place is never an outlier."""

ROUNDS: Final = 4
WORST_CONDITION: Final = 1e12
FARTHEST: Final = 1e6
"""A lattice is continued in so many rounds; a homography that is all but singular, or reaches further, is none."""

CLEARLY_A_LATTICE: Final = 0.7
"""Share of the balls that a lattice explains, times the share of its places that are taken."""

MIN_LATTICE: Final = 0.4
"""The same share under which many balls form no lattice."""


@dataclass(frozen=True, slots=True, eq=False)
class BallLattice:
    """Balls and their places.

    index : int array of shape (N, 2), place (along columns, along rows) in steps; meaningless where not `on`
    on : bool array of shape (N,), False for balls that take no place of the lattice
    to_pixels : float64 array of shape (3, 3), homography from places to (column, row)
    """

    index: NDArray[np.intp]
    on: MaskArray
    to_pixels: Float64Array

    def pixels(self, places: NDArray[np.floating] | NDArray[np.intp]) -> Float64Array:
        """(column, row) of places, arrays of shape (K, 2)."""
        return project(self.to_pixels, np.asarray(places, np.float64))

    def step_px(self, place: NDArray[np.floating] | NDArray[np.intp]) -> float:
        """Return the distance in pixels of neighbouring places about a place, the mean of both directions."""
        beside: Float64Array = np.asarray(place, np.float64) + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
        around = self.pixels(beside)
        return float(np.hypot(*(around[1:] - around[0]).T).mean())

    def missing(self) -> NDArray[np.intp]:
        """Return the places among and around the taken ones that no ball takes: int array of shape (K, 2).

        They lie within the bounding rectangle of the taken places and one step around it.
        """
        taken = self.index[self.on]
        low, high = taken.min(axis=0) - 1, taken.max(axis=0) + 1
        every = np.stack(np.meshgrid(*(np.arange(a, b + 1) for a, b in zip(low, high, strict=True))), axis=-1)
        places = every.reshape(-1, 2)
        return np.asarray(places[~(places[:, None] == taken).all(axis=2).any(axis=1)], np.intp)


def find_lattice(points: Float64Array) -> BallLattice | None:
    """Return the lattice on which balls at (column, row), array of shape (N, 2), lie; None when they form none."""
    best: tuple[float, BallLattice] | None = None
    if len(points) < MIN_BALLS:
        return None
    for seed, basis in _seeds(points):
        lattice = _completed(points, _grown(points, seed, basis))
        if lattice is None:
            continue
        score = float(lattice.on.mean()) * _taken_share(lattice)
        if best is None or score > best[0]:
            best = score, lattice
        if score > CLEARLY_A_LATTICE:
            break
    if best is None:
        return None
    needed = MIN_LATTICE if best[1].on.sum() >= PERSPECTIVE_BALLS else CLEARLY_A_LATTICE
    return _upright(best[1]) if best[0] > needed else None


def _seeds(points: Float64Array) -> Iterator[tuple[int, Float64Array]]:
    """Yield balls near the middle of all, each with two steps (2, 2) to neighbours that may span a lattice."""
    central = np.argsort(np.hypot(*(points - np.median(points, axis=0)).T))[:SEEDS]
    for seed in central:
        steps = points - points[seed]
        near = np.argsort(np.hypot(*steps.T))[1 : NEIGHBOURS + 1]
        for one, other in combinations(near, 2):
            basis = np.stack([steps[one], steps[other]])
            lengths = np.hypot(*basis.T)
            area = abs(float(np.linalg.det(basis)))
            if lengths.max() < 2.0 * lengths.min() and area > 0.6 * float(lengths.prod()):
                yield int(seed), basis


def _grown(points: Float64Array, seed: int, basis: Float64Array) -> dict[tuple[int, int], int]:
    """Return balls by place, reached from a seed in steps of one place."""
    taken: dict[tuple[int, int], int] = {(0, 0): seed}
    free = np.ones(len(points), np.bool_)
    free[seed] = False
    queue = [((0, 0), basis)]
    while queue:
        place, here = queue.pop(0)
        at = points[taken[place]]
        for axis, sign in ((0, 1), (0, -1), (1, 1), (1, -1)):
            beside = (place[0] + sign * (axis == 0), place[1] + sign * (axis == 1))
            away = np.hypot(*(points - at - sign * here[axis]).T)
            away[~free] = np.inf
            nearest = int(np.argmin(away))
            if beside in taken or away[nearest] > GROWTH * np.hypot(*here[axis]):
                continue
            free[nearest] = False
            taken[beside] = nearest
            bent = here.copy()
            bent[axis] = sign * (points[nearest] - at)
            queue.append((beside, bent))
    return taken


def _completed(points: Float64Array, grown: dict[tuple[int, int], int]) -> BallLattice | None:
    """Return the grown lattice, continued over gaps and without outliers.

    None where too few balls support it, or no camera would show it so.
    """
    index = np.zeros((len(points), 2), np.intp)
    on = np.zeros(len(points), np.bool_)
    for place, number in grown.items():
        index[number], on[number] = place, True
    if not _spread_out(index[on]):
        return None
    homography = _laid(index[on], points[on])
    for _ in range(ROUNDS):
        if np.linalg.cond(homography) > WORST_CONDITION:
            return None
        places = np.clip(project(np.asarray(np.linalg.inv(homography), np.float64), points), -FARTHEST, FARTHEST)
        index = np.round(places).astype(np.intp)
        stray = np.hypot(*(places - index).T)
        limit = max(OUTLIER * 1.4826 * float(np.median(stray[on])) / 1.1774, MIN_STRAY)
        on = _one_a_place(index, stray, stray < min(limit, ON_LATTICE))
        if not _spread_out(index[on]):
            return None
        homography = _laid(index[on], points[on])
    # A cell's area goes with the cube of its depth: of one sign and not too uneven in front of a camera.
    depth = index[on] @ homography[2, :2] + homography[2, 2]
    plausible = depth.min() * depth.max() > 0.0 and (np.abs(depth).max() / np.abs(depth).min()) ** 3 < STEEPEST
    return BallLattice(index, on, homography) if plausible else None


def _laid(places: NDArray[np.intp], points: Float64Array) -> Float64Array:
    """Return the homography of shape (3, 3) from places to points, without perspective where the balls are few."""
    if len(places) >= PERSPECTIVE_BALLS:
        return fit_homography(places.astype(np.float64), points)
    design = np.concatenate([places, np.ones((len(places), 1))], axis=1)
    affine = np.linalg.lstsq(design, points, rcond=None)[0].T
    return np.concatenate([affine, [[0.0, 0.0, 1.0]]])


def _spread_out(places: NDArray[np.intp]) -> bool:
    """Return True if places hold up a homography: enough of them, and not all but a few in one line."""
    if len(places) < MIN_BALLS:
        return False
    return bool(np.linalg.svd(places - places.mean(axis=0), compute_uv=False)[1] > 0.8)


def _one_a_place(index: NDArray[np.intp], stray: Float64Array, near: MaskArray) -> MaskArray:
    """Return, of balls that claim one place, the nearest alone."""
    kept = np.zeros(len(index), np.bool_)
    seen: set[tuple[int, int]] = set()
    for number in np.argsort(stray):
        place = (int(index[number, 0]), int(index[number, 1]))
        if near[number] and place not in seen:
            seen.add(place)
            kept[number] = True
    return kept


def _taken_share(lattice: BallLattice) -> float:
    """Return the fraction of the places inside the lattice's convex hull that balls take.

    By Pick's theorem a hull holds as many places as its area, half of its border, and one.
    """
    places = lattice.index[lattice.on].astype(np.float32)
    hull = cv2.convexHull(places)
    around = np.abs(np.diff(np.concatenate([hull, hull[:1]])[:, 0], axis=0)).astype(int)
    border = float(np.gcd(around[:, 0], around[:, 1]).sum())
    return float(len(places) / (cv2.contourArea(hull) + 0.5 * border + 1.0))


def _upright(lattice: BallLattice) -> BallLattice:
    """Return the lattice counted from its middle ball, first axis along columns and second along rows."""
    taken = lattice.index[lattice.on]
    middle = taken[np.argmin(np.hypot(*(taken - np.median(taken, axis=0)).T))]
    jacobian = (lattice.pixels(middle + np.array([[1.0, 0.0], [0.0, 1.0]])) - lattice.pixels(middle[None])).T
    turns = [np.array(m) for m in ([[1, 0], [0, 1]], [[0, 1], [1, 0]])]
    turns = [turn * np.array(signs) for turn in turns for signs in ([1, 1], [1, -1], [-1, 1], [-1, -1])]
    turn = max(turns, key=lambda t: float(np.trace(jacobian @ t / np.hypot(*(jacobian @ t)))))
    index = (lattice.index - middle) @ turn  # a signed permutation: its inverse is its transpose
    homography = _laid(np.asarray(index[lattice.on], np.intp), lattice.pixels(taken))
    return BallLattice(np.asarray(index, np.intp), lattice.on, homography)


# Homographies: how one plane is seen in perspective.


def project(homography: Float64Array, points: Float64Array) -> Float64Array:
    """Return points of shape (K, 2) mapped by a homography of shape (3, 3)."""
    mapped = np.concatenate([points, np.ones((len(points), 1))], axis=1) @ homography.T
    depth = np.where(mapped[:, 2:] == 0.0, np.finfo(np.float64).tiny, mapped[:, 2:])
    return np.asarray(mapped[:, :2] / depth)


def fit_homography(places: Float64Array, points: Float64Array) -> Float64Array:
    """Return the homography of shape (3, 3) from places to points, at least four of each; direct linear fit."""
    (a, from_places), (b, from_points) = _normalised(places), _normalised(points)
    zero, one = np.zeros((len(a), 3)), np.concatenate([a, np.ones((len(a), 1))], axis=1)
    rows = np.concatenate(
        [np.concatenate([one, zero, -b[:, :1] * one], axis=1), np.concatenate([zero, one, -b[:, 1:] * one], axis=1)]
    )
    solution = np.linalg.svd(rows)[2][-1].reshape(3, 3)
    homography = np.linalg.inv(from_points) @ solution @ from_places
    return np.asarray(homography / np.linalg.norm(homography))


def _normalised(points: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Return points about their middle in units of their spread, and the matrix that makes them so."""
    middle = points.mean(axis=0)
    scale = 1.0 / max(float(np.abs(points - middle).mean()), 1e-9)
    matrix = np.array([[scale, 0.0, -scale * middle[0]], [0.0, scale, -scale * middle[1]], [0.0, 0.0, 1.0]])
    return (points - middle) * scale, matrix
