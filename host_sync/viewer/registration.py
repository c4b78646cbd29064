"""Registration of two presses of one object: shift, turn and level, and the difference that remains.

Phase correlation of the slopes finds the shift to one cell of the reduced field. It does not see level or slow form: a
deeper or tilted press has other heights, but the same detail. Robust least squares over the common field then find
shift, turn, height and tilt together, to a fraction of a pixel. Heights between pixels are interpolated here and not by
OpenCV's remap, which resolves places to 1/32 pixel only.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from device.surface.fields import Float32Array, HeightMap, MaskArray
from host_sync.errors import ViewError
from host_sync.kernels.jit import njit

COARSE_PX: Final = 768
ROUNDS: Final = 20
MAX_EQUATIONS: Final = 30_000
SETTLED_PX: Final = 0.002
TURN_GAIN: Final = 0.9
"""A turn is accepted when the median residual falls below this fraction of that without a turn."""

NOTHING_IN_COMMON: Final = "the two scans hardly overlap: choose two of the same place"
MIN_SHARE: Final = 0.02
"""Least common field, as a fraction of the first map."""

Float64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class _Pose:
    """Position in the second map, px of the first's pitch: rotation about the centre, then shift."""

    down: float = 0.0
    right: float = 0.0
    turn: float = 0.0


def difference(
    first: HeightMap,
    second: HeightMap,
    sigmas_um: tuple[Float32Array | None, Float32Array | None] = (None, None),
) -> Difference:
    """The second height map minus the first, after registration and levelling.

    sigmas_um : standard uncertainty of each, of its height map's shape, if known

    Raises
    ------
    ViewError
        They hardly overlap.
    """
    other = _at_pitch(second, first.pitch_um)
    start = _coarse(first.z_um, other)
    straight, turned = (_refined(first.z_um, other, start, turning=turning) for turning in (False, True))
    # The turn of a round object is undetermined: it is accepted only when it explains the residual.
    pose, level, _ = turned if turned[2] < TURN_GAIN * straight[2] else straight
    moved = _moved(other, pose, first.z_um.shape, 1)
    rest = moved - first.z_um - _plane(first.z_um.shape, level, 1)
    known = np.isfinite(rest)
    if known.mean() < MIN_SHARE:
        raise ViewError(NOTHING_IN_COMMON)
    pitch_um = first.pitch_um
    return Difference(
        z_um=rest.astype(np.float32),
        shift_um=(float(pose.down) * pitch_um, float(pose.right) * pitch_um),
        turn_deg=float(np.degrees(pose.turn)),
        offset_um=float(level[0]),
        tilt=(float(level[1]) / pitch_um, float(level[2]) / pitch_um),
        residual_um=float(np.sqrt(np.mean(rest[known] ** 2))),
        median_um=float(np.median(np.abs(rest[known]))),
        overlap_share=float(known.mean()),
        agreement=slope_agreement(first.z_um, moved),
        sigma_um=_both(sigmas_um, second.pitch_um, pitch_um, pose, known),
    )


def _both(
    sigmas_um: tuple[Float32Array | None, Float32Array | None],
    pitch_um: float,
    wanted_um: float,
    pose: _Pose,
    known: MaskArray,
) -> Float32Array | None:
    """Combined uncertainty of both as independent, on the grid of the first; NaN where the difference is invalid."""
    first, second = sigmas_um
    if first is None or second is None:
        return None
    moved = _moved(_at_pitch(HeightMap(second, pitch_um), wanted_um), pose, first.shape, 1)
    return np.where(known, np.hypot(first, moved), np.float32(np.nan)).astype(np.float32)


def _at_pitch(height: HeightMap, pitch_um: float) -> Float32Array:
    """The height map resampled to another pitch."""
    factor = height.pitch_um / pitch_um
    if abs(factor - 1.0) < 1e-3:
        return height.z_um
    size = (max(2, round(height.z_um.shape[1] * factor)), max(2, round(height.z_um.shape[0] * factor)))
    if max(size) > 32_000:
        raise ViewError("the pixel pitches of the two scans differ too much: compare scans of one kind of device")
    way = cv2.INTER_AREA if factor < 1.0 else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(height.z_um, size, interpolation=way), np.float32)


def _coarse(first: Float32Array, second: Float32Array) -> _Pose:
    """The shift to one cell, by phase correlation of the slopes of both, padded to one size."""
    step = max(1, int(np.ceil(max(*first.shape, *second.shape) / COARSE_PX)))
    small = [reduced(z_um, step) for z_um in (first, second)]
    rows, columns = (cv2.getOptimalDFTSize(2 * max(one.shape[axis] for one in small)) for axis in (0, 1))
    spectra = [np.fft.fft2(_complex_slopes(one), (rows, columns)) for one in small]
    cross = np.conj(spectra[0]) * spectra[1]
    size = np.abs(cross)
    if not size.max() > 0.0:
        return _Pose()
    # Phases are weighted by the root of their power, so that neither noise nor a single strong period dominates.
    peak = np.fft.ifft2(cross / np.sqrt(size + 1e-6 * size.max())).real
    down, right = np.unravel_index(int(np.argmax(peak)), peak.shape)
    signed = [int(at) - full if at > full // 2 else int(at) for at, full in ((down, rows), (right, columns))]
    return _Pose(float(signed[0] * step), float(signed[1] * step))


def _complex_slopes(z_um: Float32Array) -> NDArray[np.complex128]:
    """p + iq without their means, 0 where invalid: one transform carries both."""
    q, p = np.gradient(z_um)
    known = np.isfinite(p) & np.isfinite(q)
    if not known.any():
        raise ViewError("one of the scans has no valid pixel: choose another")
    slopes = np.where(known, p + 1j * q, 0.0)
    return np.asarray(np.where(known, slopes - slopes[known].mean(), 0.0), np.complex128)


def _refined(first: Float32Array, second: Float32Array, pose: _Pose, *, turning: bool) -> tuple[_Pose, Float64, float]:
    """Shift and turn to a fraction of a pixel, level (height, tilts; µm, µm/px), and median residual, µm."""
    step = max(1, int(np.ceil(max(first.shape) / FIT_PX)))
    fixed = reduced(first, step)
    row, column = _centred(fixed.shape, first.shape, step)
    level, left_um = np.zeros(3), 0.0
    for _ in range(ROUNDS):
        moved = _moved(second, pose, fixed.shape, step)
        q, p = np.gradient(moved, float(step))
        rest = moved - fixed
        known = np.isfinite(rest) & np.isfinite(p) & np.isfinite(q)
        if known.mean() < MIN_SHARE:
            raise ViewError(NOTHING_IN_COMMON)
        parts = [np.ones_like(p), row, column, -q, -p, p * row - q * column][: 6 if turning else 5]
        places = np.flatnonzero(known)
        places = places[:: max(1, len(places) // MAX_EQUATIONS)]
        design = np.stack([part.ravel()[places] for part in parts], axis=-1).astype(np.float64)
        found, left_um = _robust(design, rest.ravel()[places].astype(np.float64))
        level = found[:3]
        pose = _Pose(pose.down + found[3], pose.right + found[4], pose.turn + (found[5] if turning else 0.0))
        if np.abs(found[3:5]).max() < SETTLED_PX:
            break
    return pose, level, left_um


def _robust(design: Float64, target: Float64) -> tuple[Float64, float]:
    """Least squares with Tukey weights, and the median residual; undetermined directions stay 0."""
    scale = np.maximum(np.sqrt((design**2).mean(axis=0)), 1e-12)
    scaled = design / scale
    weight = np.ones(len(target))
    found, median = np.zeros(design.shape[1]), 0.0
    for _ in range(4):
        weighted = scaled * weight[:, None]
        # Shift and tilt of a ball are equivalent: undetermined directions are not moved.
        found = np.linalg.lstsq(weighted.T @ scaled, weighted.T @ target, rcond=1e-6)[0]
        off = np.abs(target - scaled @ found)
        median = float(np.median(off))
        spread = max(4.685 * 1.4826 * median, 1e-9)
        weight = np.clip(1.0 - (off / spread) ** 2, 0.0, None) ** 2
    return np.asarray(found / scale), median


def _moved(z_um: Float32Array, pose: _Pose, shape: tuple[int, ...], step: int) -> Float32Array:
    """The second map at the pixels of the first (reduced by `step`); NaN outside it and beside its holes."""
    small = reduced(z_um, step)
    full = (shape[0] * step, shape[1] * step)
    row, column = _centred(shape, full, step)
    centre = (0.5 * (full[0] - 1), 0.5 * (full[1] - 1))
    at_row = centre[0] + pose.down + np.cos(pose.turn) * row + np.sin(pose.turn) * column
    at_column = centre[1] + pose.right - np.sin(pose.turn) * row + np.cos(pose.turn) * column
    down, right = (((at + 0.5) / step - 0.5).astype(np.float32) for at in (at_row, at_column))
    return between_pixels(small, down, right)


def _plane(shape: tuple[int, ...], level: Float64, step: int) -> Float32Array:
    row, column = _centred(shape, shape, step)
    return np.asarray(level[0] + level[1] * row + level[2] * column, np.float32)


def _centred(shape: tuple[int, ...], full: tuple[int, ...], step: int) -> tuple[Float32Array, Float32Array]:
    """Rows and columns of the cell centres relative to the map's centre, px of the full map: arrays of shape (h, w)."""
    places = [
        ((np.arange(count) + 0.5) * step - 0.5 - 0.5 * (whole - 1)).astype(np.float32)
        for count, whole in zip(shape[:2], full[:2], strict=True)
    ]
    row, column = np.meshgrid(*places, indexing="ij")
    return row, column


FIT_PX: Final = 1024
SMOOTHED_PX: Final = 2.0
MIN_AGREEMENT: Final = 0.6
"""Least correlation of the smoothed slopes of two presses of one object. The same object with 1 µm of noise gives 0.99,
unrelated textures after registration at most 0.35, unrelated fields of three or four broad hills 0.65."""


@dataclass(frozen=True, slots=True, eq=False)
class Difference:
    """The second height map minus the first, on the grid of the first.

    z_um : float32 array of shape (H, W), NaN where either is invalid
    shift_um : (rows, columns), displacement of the object in the second map, at the centre, down and right positive
    turn_deg : rotation of the object in the second map, clockwise on the screen
    offset_um, tilt : height (µm) and tilt (rows, columns; µm/µm) that were subtracted
    residual_um : root mean square of the difference
    median_um : median of its absolute value
    overlap_share : common field as a fraction of the first map
    agreement : correlation of the slopes over the common field, 1 for identical maps
    sigma_um : float32 array of shape (H, W), combined standard uncertainty; None where a map has none
    """

    z_um: Float32Array
    shift_um: tuple[float, float]
    turn_deg: float
    offset_um: float
    tilt: tuple[float, float]
    residual_um: float
    median_um: float
    overlap_share: float
    agreement: float
    sigma_um: Float32Array | None

    @property
    def warning(self) -> str:
        """Why the two may not show the same object; empty if they agree."""
        if self.agreement >= MIN_AGREEMENT:
            return ""
        return (
            f"their slopes agree by only {100.0 * max(self.agreement, 0.0):.0f} % (the same object: over "
            f"{100.0 * MIN_AGREEMENT:.0f} %): they may show different things, and the difference then has no meaning"
        )


def slope_agreement(first: Float32Array, moved: Float32Array) -> float:
    """Correlation of the slopes of two registered maps; 0 if either is flat."""
    step = max(1, int(np.ceil(max(first.shape) / FIT_PX)))
    slopes = []
    for z_um in (first, moved):
        small = cv2.GaussianBlur(reduced(z_um, step), (0, 0), SMOOTHED_PX)
        q, p = np.gradient(small)
        slopes.append(p + 1j * q)
    known = np.isfinite(slopes[0]) & np.isfinite(slopes[1])
    one, other = (found[known] - found[known].mean() for found in slopes)
    size = float(np.sqrt((np.abs(one) ** 2).sum() * (np.abs(other) ** 2).sum()))
    return float(np.real(np.vdot(one, other))) / size if size > 0.0 else 0.0


def between_pixels(z_um: Float32Array, row: Float32Array, column: Float32Array) -> Float32Array:
    """Heights at places (px) by cubic convolution: float32 array of the places' shape.

    NaN where one of the 4 × 4 neighbours is invalid or outside.
    """
    found = np.empty(row.shape, np.float32)
    _convolve(np.ascontiguousarray(z_um), np.ascontiguousarray(row), np.ascontiguousarray(column), found)
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def _weights(t: Any) -> Any:
    """Weights of the pixels at -1, 0, 1 and 2 for a place at fraction `t` of a pixel."""
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


def reduced(z_um: Float32Array, step: int) -> Float32Array:
    """Means over squares of `step` pixels; rows and columns beyond the last whole square are dropped."""
    if step == 1:
        return z_um
    rows, columns = (size // step for size in z_um.shape)
    part = z_um[: rows * step, : columns * step]
    return np.asarray(cv2.resize(part, (columns, rows), interpolation=cv2.INTER_AREA), np.float32)
