"""Least squares of the slopes of two maps over pose and tilt, and how sure the pose is, and maps resampled.

Slopes do not know a height or a long wave: another depth leaves them as they are wherever both presses touch the
object. Tukey weights leave aside where they do not. The uncertainty is a delete-one jackknife over tiles of the field,
for what differs between two presses is no noise from pixel to pixel: lift-off, skin, patches of slope error. Tiles are
not independent of each other, so it is widened by what a hundred twin pairs showed.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from device.align import Pose
from device.surface import Float32Array, Float64Array, HeightMap, MaskArray, mean_heights
from host_sync.errors import ViewError
from host_sync.kernels.jit import njit

MAX_SIDE_PX: Final = 32_000


def at_pitch(height: HeightMap, pitch_um: float) -> Float32Array:
    """Return the height map resampled to another pitch.

    Raises
    ------
    ViewError
        The pitches differ too much.
    """
    factor = height.pitch_um / pitch_um
    if abs(factor - 1.0) < 1e-3:
        return height.z_um
    size = (max(2, round(height.z_um.shape[1] * factor)), max(2, round(height.z_um.shape[0] * factor)))
    if max(size) > MAX_SIDE_PX:
        raise ViewError("the pixel pitches of the two scans differ too much: compare scans of one kind of device")
    way = cv2.INTER_AREA if factor < 1.0 else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(height.z_um, size, interpolation=way), np.float32)


def moved(small: Float32Array, pose: Pose, shape: tuple[int, ...], step: int) -> Float32Array:
    """Return the second map at the pixels of the first; NaN outside it and next to its holes.

    small : the second map, reduced by `step`
    pose : of the second, px of the first, from where the first's middle lies when both lie corner on corner
    shape : of the first map, reduced by `step`
    """
    full = (shape[0] * step, shape[1] * step)
    row, column = centred(shape, full, step)
    at_row = 0.5 * (full[0] - 1) + pose.down + np.cos(pose.turn) * row + np.sin(pose.turn) * column
    at_column = 0.5 * (full[1] - 1) + pose.right - np.sin(pose.turn) * row + np.cos(pose.turn) * column
    down, right = (((at + 0.5) / step - 0.5).astype(np.float32) for at in (at_row, at_column))
    return between_pixels(small, down, right)


def centred(shape: tuple[int, ...], full: tuple[int, ...], step: int) -> tuple[Float32Array, Float32Array]:
    """Return rows and columns of the cell centres relative to the map's centre, px of the full map: arrays (h, w)."""
    places = [
        ((np.arange(count) + 0.5) * step - 0.5 - 0.5 * (whole - 1)).astype(np.float32)
        for count, whole in zip(shape[:2], full[:2], strict=True)
    ]
    row, column = np.meshgrid(*places, indexing="ij")
    return row, column


def reduced(z_um: Float32Array, step: int) -> Float32Array:
    """Return means of valid pixels over squares of `step`; rows and columns beyond the last whole square are dropped.

    NaN where half of a square or more is invalid.
    """
    if step == 1:
        return z_um
    rows, columns = (size // step for size in z_um.shape)
    means, known = mean_heights(z_um[: rows * step, : columns * step], (rows, columns))
    return np.asarray(np.where(known, means, np.float32(np.nan)), np.float32)


def between_pixels(z_um: Float32Array, row: Float32Array, column: Float32Array) -> Float32Array:
    """Return heights at places (px) by cubic convolution: float32 array of the places' shape.

    NaN where one of the 4 × 4 neighbours is invalid or outside. OpenCV's remap resolves places to 1/32 pixel only.
    """
    found = np.empty(row.shape, np.float32)
    _convolve(np.ascontiguousarray(z_um), np.ascontiguousarray(row), np.ascontiguousarray(column), found)
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def _weights(t: Any) -> Any:
    """Return weights of the pixels at -1, 0, 1 and 2 for a place at fraction `t` of a pixel."""
    t2, t3 = t * t, t * t * t
    return (
        np.float32(0.5 * (-t3 + 2.0 * t2 - t)),
        np.float32(0.5 * (3.0 * t3 - 5.0 * t2 + 2.0)),
        np.float32(0.5 * (-3.0 * t3 + 4.0 * t2 + t)),
        np.float32(0.5 * (t3 - t2)),
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _convolve(z_um: Any, row: Any, column: Any, found: Any) -> None:
    """Write the heights."""
    rows, columns = z_um.shape
    for r in range(found.shape[0]):
        for c in range(found.shape[1]):
            at_row, at_column = int(np.floor(row[r, c])), int(np.floor(column[r, c]))
            if at_row < 1 or at_column < 1 or at_row + 2 >= rows or at_column + 2 >= columns:
                found[r, c] = np.nan
                continue
            down = _weights(row[r, c] - np.float32(at_row))
            right = _weights(column[r, c] - np.float32(at_column))
            total = np.float32(0.0)
            for i in range(4):
                line = np.float32(0.0)
                for j in range(4):
                    line += right[j] * z_um[at_row - 1 + i, at_column - 1 + j]
                total += down[i] * line
            found[r, c] = total


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
