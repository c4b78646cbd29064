"""Two presses of one thing laid on each other: shift, turn and level, and what remains.

Phase correlation of the slopes finds the shift to a cell of the reduced field; it sees no level and no slow form. Then
least squares over the common field find shift, turn, height and tilt together to a part of a pixel; pixels that do not
fit weigh less. Why slopes and not heights for the first step: a press deeper or tilted has other heights, but the same
detail.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from device.surface import Float32Array, HeightMap, MaskArray
from host_sync.errors import ViewError
from host_sync.viewer.difference import FIT_PX, Difference, slope_agreement
from host_sync.viewer.resampling import between_pixels, reduced

COARSE_PX: Final = 768
ROUNDS: Final = 20
MOST_EQUATIONS: Final = 30_000
SETTLED_PX: Final = 0.002
TURN_GAIN: Final = 0.9
"""A turn counts when it leaves at most this share of the median that shift and level alone leave."""

NOTHING_IN_COMMON: Final = "the two scans have hardly any pixel in common: choose two of the same place"
LEAST_SHARE: Final = 0.02
"""The common field must be at least this share of the first map."""

Float64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class _Pose:
    """Place in the second map, px of the first's pitch: turned about the centre, then shifted."""

    down: float = 0.0
    right: float = 0.0
    turn: float = 0.0


def difference(
    first: HeightMap,
    second: HeightMap,
    sigmas_um: tuple[Float32Array | None, Float32Array | None] = (None, None),
) -> Difference:
    """The second height map minus the first, after registration and levelling.

    sigmas_um : standard uncertainty of each, of its height map's shape, where it is known

    Raises
    ------
    ViewError
        They show nothing in common.
    """
    other = _at_pitch(second, first.pitch_um)
    start = _coarse(first.z_um, other)
    straight, turned = (_refined(first.z_um, other, start, turning=turning) for turning in (False, True))
    # A round thing can be turned at will: a turn counts only when it explains what remains.
    pose, level, _ = turned if turned[2] < TURN_GAIN * straight[2] else straight
    moved = _moved(other, pose, first.z_um.shape, 1)
    rest = moved - first.z_um - _plane(first.z_um.shape, level, 1)
    known = np.isfinite(rest)
    if known.mean() < LEAST_SHARE:
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
    """Both uncertainties as if independent, on the grid of the first; NaN where the difference is unknown."""
    first, second = sigmas_um
    if first is None or second is None:
        return None
    moved = _moved(_at_pitch(HeightMap(second, pitch_um), wanted_um), pose, first.shape, 1)
    return np.where(known, np.hypot(first, moved), np.float32(np.nan)).astype(np.float32)


def _at_pitch(height: HeightMap, pitch_um: float) -> Float32Array:
    """The height map on a grid of another pitch."""
    factor = height.pitch_um / pitch_um
    if abs(factor - 1.0) < 1e-3:
        return height.z_um
    size = (max(2, round(height.z_um.shape[1] * factor)), max(2, round(height.z_um.shape[0] * factor)))
    if max(size) > 32_000:
        raise ViewError("the pixel pitches of the two scans differ too much: compare scans of one kind of device")
    way = cv2.INTER_AREA if factor < 1.0 else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(height.z_um, size, interpolation=way), np.float32)


def _coarse(first: Float32Array, second: Float32Array) -> _Pose:
    """The shift to a cell, by phase correlation of the slopes of both, padded to one size."""
    step = max(1, int(np.ceil(max(*first.shape, *second.shape) / COARSE_PX)))
    small = [reduced(z_um, step) for z_um in (first, second)]
    rows, columns = (cv2.getOptimalDFTSize(2 * max(one.shape[axis] for one in small)) for axis in (0, 1))
    spectra = [np.fft.fft2(_complex_slopes(one), (rows, columns)) for one in small]
    cross = np.conj(spectra[0]) * spectra[1]
    size = np.abs(cross)
    if not size.max() > 0.0:
        return _Pose()
    # Phases count by the root of their power: noise alone says nothing, and a single strong period not everything.
    peak = np.fft.ifft2(cross / np.sqrt(size + 1e-6 * size.max())).real
    down, right = np.unravel_index(int(np.argmax(peak)), peak.shape)
    signed = [int(at) - full if at > full // 2 else int(at) for at, full in ((down, rows), (right, columns))]
    return _Pose(float(signed[0] * step), float(signed[1] * step))


def _complex_slopes(z_um: Float32Array) -> NDArray[np.complex128]:
    """p + iq without their means, nought where invalid: one transform carries both."""
    q, p = np.gradient(z_um)
    known = np.isfinite(p) & np.isfinite(q)
    if not known.any():
        raise ViewError("one of the scans has no valid pixel: choose another")
    slopes = np.where(known, p + 1j * q, 0.0)
    return np.asarray(np.where(known, slopes - slopes[known].mean(), 0.0), np.complex128)


def _refined(first: Float32Array, second: Float32Array, pose: _Pose, *, turning: bool) -> tuple[_Pose, Float64, float]:
    """Shift and turn to a part of a pixel, level (height, tilts; µm, µm/px), and the median of what remains, µm."""
    step = max(1, int(np.ceil(max(first.shape) / FIT_PX)))
    fixed = reduced(first, step)
    row, column = _centred(fixed.shape, first.shape, step)
    level, left_um = np.zeros(3), 0.0
    for _ in range(ROUNDS):
        moved = _moved(second, pose, fixed.shape, step)
        q, p = np.gradient(moved, float(step))
        rest = moved - fixed
        known = np.isfinite(rest) & np.isfinite(p) & np.isfinite(q)
        if known.mean() < LEAST_SHARE:
            raise ViewError(NOTHING_IN_COMMON)
        parts = [np.ones_like(p), row, column, -q, -p, p * row - q * column][: 6 if turning else 5]
        places = np.flatnonzero(known)
        places = places[:: max(1, len(places) // MOST_EQUATIONS)]
        design = np.stack([part.ravel()[places] for part in parts], axis=-1).astype(np.float64)
        found, left_um = _robust(design, rest.ravel()[places].astype(np.float64))
        level = found[:3]
        pose = _Pose(pose.down + found[3], pose.right + found[4], pose.turn + (found[5] if turning else 0.0))
        if np.abs(found[3:5]).max() < SETTLED_PX:
            break
    return pose, level, left_um


def _robust(design: Float64, target: Float64) -> tuple[Float64, float]:
    """Least squares in which what is far off weighs less (Tukey), and the median of what remains.

    Directions that nothing determines stay nought.
    """
    scale = np.maximum(np.sqrt((design**2).mean(axis=0)), 1e-12)
    scaled = design / scale
    weight = np.ones(len(target))
    found, median = np.zeros(design.shape[1]), 0.0
    for _ in range(4):
        weighted = scaled * weight[:, None]
        # Shift and tilt of a ball are one and the same: what the data leave open is not moved.
        found = np.linalg.lstsq(weighted.T @ scaled, weighted.T @ target, rcond=1e-6)[0]
        off = np.abs(target - scaled @ found)
        median = float(np.median(off))
        spread = max(4.685 * 1.4826 * median, 1e-9)
        weight = np.clip(1.0 - (off / spread) ** 2, 0.0, None) ** 2
    return np.asarray(found / scale), median


def _moved(z_um: Float32Array, pose: _Pose, shape: tuple[int, ...], step: int) -> Float32Array:
    """The second map where the first one's pixels (reduced by `step`) lie on it; NaN beyond it and beside its holes."""
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
    """Rows and columns of the cells' centres from the map's centre, px of the full map: arrays of shape (h, w)."""
    places = [
        ((np.arange(count) + 0.5) * step - 0.5 - 0.5 * (whole - 1)).astype(np.float32)
        for count, whole in zip(shape[:2], full[:2], strict=True)
    ]
    row, column = np.meshgrid(*places, indexing="ij")
    return row, column
