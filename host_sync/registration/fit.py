"""Least squares of the slopes of two maps over pose and tilt, and how sure the pose is.

Slopes do not know a height or a long wave: another depth leaves them as they are wherever both presses touch the
object. Tukey weights leave aside where they do not. The uncertainty is a delete-one jackknife over tiles of the field,
for what differs between two presses is no noise from pixel to pixel: lift-off, skin, patches of slope error. Tiles are
not independent of each other, so it is widened by what a hundred twin pairs showed.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from device.align import Pose
from device.surface import Float32Array, Float64Array, MaskArray
from host_sync.registration.resampling import centred, moved, reduced

ROUNDS: Final = 20
PLAIN_ROUNDS: Final = 4
"""First rounds without weights, which see farther."""

SETTLED_PX: Final = 0.002
TILES: Final = 8
"""Tiles along either side of the field."""

MIN_COMMON: Final = 0.02
"""Least common field, as a fraction of the first map."""

SMOOTHED_PX: Final = 1.5
UNDETERMINED: Final = 1e-7
"""Eigenvalue of the scaled normal matrix, relative to the largest, below which a direction is not determined."""

DIRECTIONS: Final = 36
INFLATION: Final = 1.75
"""Error over jackknife uncertainty, root mean square over accepted pairs of the twin's presses with hand-like shifts
(tests/host_sync/registration/test_pairs.py)."""

TUKEY: Final = 4.685
PARAMETERS: Final = 5
"""Tilt along rows and columns, then shift down, right, and turn."""


@dataclass(frozen=True, slots=True, eq=False)
class Pair:
    """Both maps, reduced by `step`, of the first's pitch."""

    first: Float32Array
    second: Float32Array
    step: int

    @classmethod
    def of(cls, first: Float32Array, second: Float32Array, max_px: int) -> Pair:
        """Return the pair with at most so many rows and columns of the first, smoothed by little."""
        step = max(1, int(np.ceil(max(first.shape) / max_px)))
        small = (cv2.GaussianBlur(reduced(z_um, step), (0, 0), SMOOTHED_PX) for z_um in (first, second))
        one, other = (np.asarray(z_um, np.float32) for z_um in small)
        return cls(one, other, step)

    @property
    def reach_px(self) -> float:
        """Half the diagonal of the first map, px."""
        return 0.5 * self.step * float(np.hypot(*self.first.shape))


def middle_px(pair: Pair) -> tuple[float, float]:
    """Return the centroid of the first map's squared slopes: row and column from the middle of the map, px."""
    q, p = np.gradient(pair.first)
    energy = np.nan_to_num(p * p + q * q).astype(np.float64)
    row, column = centred(energy.shape, tuple(size * pair.step for size in energy.shape), pair.step)
    total = max(float(energy.sum()), 1e-30)
    return float((energy * row).sum()) / total, float((energy * column).sum()) / total


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """A pose that no small change betters.

    covariance : float64 array of shape (3, 3) of down, right (px) and turn (rad); infinite where undetermined
    residual : float64 array of shape (TILES, TILES), mean squared slope difference of each tile, NaN without pixels
    agreement : correlation of the slopes over the common field
    energy : sum of squared slopes of the first map over the common field
    common : bool array of shape (h, w), pixels that both maps have
    """

    pose: Pose
    covariance: Float64Array
    residual: Float64Array
    agreement: float
    energy: float
    common: MaskArray

    @property
    def share(self) -> float:
        """Common field as a fraction of the first map."""
        return float(self.common.mean())

    @property
    def sigma_px(self) -> float:
        """Standard uncertainty of the shift along the direction that is known least, px."""
        return float(np.sqrt(max(np.linalg.eigvalsh(self.covariance[:2, :2])[-1], 0.0)))


def coherence(pair: Pair, pose: Pose) -> float:
    """Return the smallest correlation, over directions, of how both maps' slopes change along a direction.

    What determines a shift is how slopes change along it. Where only noise changes, each map has changes of its own.
    """
    seen = moved(pair.second, pose, pair.first.shape, pair.step)
    changes = []
    for z_um in (pair.first, seen):
        q, p = np.gradient(z_um)
        changes.append(np.stack([np.stack(np.gradient(slope)) for slope in (p, q)], axis=1))
    known = np.isfinite(changes[0] + changes[1]).all(axis=(0, 1))
    if known.mean() < MIN_COMMON:
        return 0.0
    one, other = (change[..., known].reshape(2, -1).astype(np.float64) for change in changes)
    angle = np.linspace(0.0, np.pi, DIRECTIONS, endpoint=False)
    way = np.stack([np.sin(angle), np.cos(angle)])

    def along(form: Float64Array) -> Float64Array:
        return np.asarray(np.einsum("ik,ij,jk->k", way, form, way), np.float64)

    size = np.sqrt(along(one @ one.T) * along(other @ other.T))
    return float((along(one @ other.T) / np.maximum(size, 1e-30)).min())


def fit(pair: Pair, start: Pose, *, turning: bool = True) -> Fit | None:
    """Return the fit that a start leads to; None when the maps hardly overlap there."""
    pose = start
    for number in range(ROUNDS):
        equations = _Equations.of(pair, pose, turning=turning, robust=number >= PLAIN_ROUNDS)
        if equations is None:
            return None
        change = equations.solved(*equations.total())[2:]
        reach = 0.5 * max(pair.first.shape) * pair.step
        size = max(float(np.abs(change[:2]).max()), reach * abs(float(change[2])))
        limit = 4.0 * pair.step
        if size > limit:
            change = change * (limit / size)
        pose = pose.moved_by(*change)
        if size < SETTLED_PX * pair.step and number > PLAIN_ROUNDS:
            break
    last = _Equations.of(pair, pose, turning=turning)
    return None if last is None else last.fit(pose)


def judged_at(pair: Pair, pose: Pose) -> Fit | None:
    """Return how well the maps agree at a pose, which is not moved; None when they hardly overlap there."""
    there = _Equations.of(pair, pose, turning=True)
    return None if there is None else there.fit(pose)


@dataclass(frozen=True, slots=True, eq=False)
class _Equations:
    """Weighted equations of the slopes at a pose.

    designs, rests : of p and of q: arrays of shape (N, PARAMETERS) and (N,)
    weight, off : float arrays of shape (N,), Tukey weight and size of the difference
    slopes : p + iq of both maps, complex arrays of shape (N,)
    common : bool array of shape (h, w), the N pixels
    """

    designs: tuple[Float32Array, Float32Array]
    rests: tuple[Float32Array, Float32Array]
    weight: Float32Array
    off: Float32Array
    slopes: tuple[NDArray[np.complex64], NDArray[np.complex64]]
    common: MaskArray

    @classmethod
    def of(cls, pair: Pair, pose: Pose, *, turning: bool, robust: bool = True) -> _Equations | None:
        step = float(pair.step)
        seen = moved(pair.second, pose, pair.first.shape, pair.step)
        q, p = _gradient(seen, step)
        q_first, p_first = _gradient(pair.first, step)
        q_row, q_column = _gradient(q, step)
        p_row, p_column = _gradient(p, step)
        known: MaskArray = np.isfinite(p_row + p_column + q_row + q_column) & np.isfinite(p_first + q_first)
        if known.mean() < MIN_COMMON:
            return None
        row, column = (
            part[known] for part in centred(pair.first.shape, tuple(n * pair.step for n in seen.shape), pair.step)
        )
        zero, one = np.zeros(row.shape, np.float32), np.ones(row.shape, np.float32)
        # A turn moves the places and turns the slopes.
        turned_p = p_row[known] * column - p_column[known] * row - q[known]
        turned_q = q_row[known] * column - q_column[known] * row + p[known]
        designs = (
            np.stack([zero, one, p_row[known], p_column[known], turned_p * turning], axis=-1),
            np.stack([one, zero, q_row[known], q_column[known], turned_q * turning], axis=-1),
        )
        rest = (p[known] - p_first[known], q[known] - q_first[known])
        middle = [float(np.median(part)) for part in rest]
        off = np.hypot(rest[0] - middle[0], rest[1] - middle[1])
        spread = max(TUKEY * float(np.median(off)), 1e-9)
        weight = np.clip(1.0 - (off / spread) ** 2, 0.0, None) ** 2 if robust else np.ones_like(off)
        slopes = (
            np.asarray(p_first + 1j * q_first, np.complex64)[known],
            np.asarray(p + 1j * q, np.complex64)[known],
        )
        return cls(designs, rest, weight, off, slopes, known)

    def total(self) -> tuple[Float64Array, Float64Array]:
        """Return the normal matrix and right side of all pixels."""
        return self._normal(slice(None))

    def _normal(self, here: slice | NDArray[np.intp]) -> tuple[Float64Array, Float64Array]:
        normal, right = np.zeros((PARAMETERS, PARAMETERS)), np.zeros(PARAMETERS)
        for design, rest in zip(self.designs, self.rests, strict=True):
            part = design[here].astype(np.float64)
            weighted = part * self.weight[here, None]
            normal += weighted.T @ part
            right -= weighted.T @ rest[here]
        return normal, right

    @staticmethod
    def solved(normal: Float64Array, right: Float64Array) -> Float64Array:
        """Return all parameters; undetermined directions stay 0."""
        scale = np.sqrt(np.maximum(np.diag(normal), 1e-30))
        scaled = normal / np.outer(scale, scale)
        return np.asarray(np.linalg.lstsq(scaled, right / scale, rcond=UNDETERMINED)[0] / scale, np.float64)

    def fit(self, pose: Pose) -> Fit:
        """Return the fit at a pose that these equations do not change any more."""
        rows, columns = np.nonzero(self.common)
        height, width = self.common.shape
        tile = (rows * TILES // height) * TILES + columns * TILES // width
        order = np.argsort(tile, kind="stable")
        ends = np.searchsorted(tile[order], np.arange(TILES**2 + 1))
        parts = [self._normal(order[first:last]) for first, last in itertools.pairwise(ends)]
        count = np.bincount(tile, minlength=TILES**2)
        with np.errstate(invalid="ignore"):
            residual = np.bincount(tile, (self.off**2).astype(np.float64), minlength=TILES**2) / count
        one, other = (field - field.mean() for field in self.slopes)
        size = float(np.sqrt((np.abs(one) ** 2).sum() * (np.abs(other) ** 2).sum()))
        agreement = float(np.real(np.vdot(one, other))) / size if size > 0.0 else 0.0
        covariance = _jackknife(np.stack([part[0] for part in parts]), np.stack([part[1] for part in parts]))
        energy = float((np.abs(self.slopes[0]) ** 2).sum())
        return Fit(pose, covariance, residual.reshape(TILES, TILES), agreement, energy, self.common)


def _gradient(values: Float32Array, step: float) -> tuple[Float32Array, Float32Array]:
    """Return changes per pixel along rows and along columns: float32 arrays of shape (h, w)."""
    down, across = np.gradient(values, step)
    return np.asarray(down, np.float32), np.asarray(across, np.float32)


def _jackknife(normal: Float64Array, right: Float64Array) -> Float64Array:
    """Return the covariance of (down, right, turn) from leaving out each tile; infinite where no shift is determined.

    normal, right : float64 arrays of shape (tiles, n, n) and (tiles, n)
    """
    total, side = normal.sum(axis=0), right.sum(axis=0)
    scale = np.sqrt(np.maximum(np.diag(total), 1e-30))
    values = np.linalg.eigvalsh((total / np.outer(scale, scale))[:4, :4])
    used = [number for number in range(len(normal)) if normal[number].any()]
    if values[0] < UNDETERMINED * values[-1] or len(used) < 2:
        return np.diag([np.inf, np.inf, np.inf])
    every = np.array([_Equations.solved(total - normal[number], side - right[number])[2:] for number in used])
    off = every - every.mean(axis=0)
    found = INFLATION**2 * (len(used) - 1) / len(used) * (off.T @ off)
    if not total[4, 4] > 0.0:
        found[2, 2] = np.inf
    return np.asarray(found, np.float64)
