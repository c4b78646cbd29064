"""From raw counts to intensity: linear light without black level, flat-field corrected by the reference frame.

Device and workstation share these functions, so that a calibration means the same on both.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from device.errors import CalibrationMismatch, FrameError
from device.surface import Float32Array, MaskArray, large_parts
from hal.frame import BayerOrder, RawFrame

REFERENCE_BLUR_PX: Final = 3.0
"""Standard deviation of the reference's Gaussian blur, which keeps its pixel noise out of every intensity."""

EDGE_VARIANCE: Final = 4.0
"""Variance of the reference's detail over its median, above which it is an edge and not noise."""

MIN_EDGE_FRACTION: Final = 0.005
"""Fraction of the field that the gel's edge covers at least; marks and dirt, which move with the skin, cover less."""

DARK_FLOOR: Final = 0.002
"""Fraction of full scale below which the reference is too dark to divide by."""

SATURATED: Final = 0.98
"""Fraction of full scale from which a pixel counts as clipped."""

BAND_ROWS: Final = 96
"""Rows of bins computed at a time, so that intermediate results stay in the second-level cache."""

BLACK_FRAME: Final = 0.01
"""A frame whose 99th percentile is below this fraction of full scale is black."""

MAX_DISAGREEMENT: Final = 0.25
"""Untouched skin of two frames under the same lights agrees to this share, however the lights drift."""

EXPOSURE_STEP: Final = 8
"""Stride, in rows and columns, of the sample that tests exposure."""

_DEMOSAIC: Final[dict[BayerOrder, int]] = {
    # OpenCV names the pattern by the second and third pixel of the second row: its BG is RGGB.
    "RGGB": cv2.COLOR_BAYER_BG2RGB,
    "BGGR": cv2.COLOR_BAYER_RG2RGB,
    "GRBG": cv2.COLOR_BAYER_GB2RGB,
    "GBRG": cv2.COLOR_BAYER_GR2RGB,
}


@dataclass(frozen=True, slots=True, eq=False)
class LinearFrame:
    """One exposure as linear light.

    rgb : float32 array of shape (H, W, 3), fraction of full scale above black, R, G, B; of other sensors than the
        handheld (H, W, N), one channel a light
    clipped : bool array of shape (H, W), True where a channel is saturated
    demosaiced : whether `demosaic` interpolated two colours of every pixel
    """

    rgb: Float32Array
    clipped: MaskArray
    demosaiced: bool = False

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W)."""
        rows, columns, _ = self.rgb.shape
        return rows, columns


@dataclass(frozen=True, slots=True, eq=False)
class NormalizedImage:
    """A flat-field-corrected frame: flat, untouched skin reads 1 in every channel.

    values : float32 array of shape (H, W, 3)
    valid : bool array of shape (H, W), False where the reference is too dark to divide by
    clipped : bool array of shape (H, W), True where a channel is saturated: its colour only bounds the slope
    """

    values: Float32Array
    valid: MaskArray
    clipped: MaskArray

    @property
    def faithful(self) -> MaskArray:
        """True where the intensity is valid and not clipped, usable for calibration."""
        return self.valid & ~self.clipped

    def faithful_at(self, pixels: Any) -> MaskArray:
        """Return `faithful` at some pixels alone: a window, or indices."""
        return np.asarray(self.valid[pixels] & ~self.clipped[pixels])

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W)."""
        rows, columns = self.valid.shape
        return rows, columns


DEMOSAIC_BLUR_PX: Final = (5 / 12) ** 0.5
"""Standard deviation of the blur of bilinear interpolation, along either axis over all pixels and colours.

Of red and blue a quarter of the pixels is seen, for half of the others a colour comes from neighbours along an axis:
variance 1/2. Of green half is seen: 1/4.
"""


def demosaic(frame: RawFrame) -> LinearFrame:
    """Return full-size linear frame from a Bayer mosaic; missing colours are interpolated bilinearly."""
    scale = np.float32(1.0 / (frame.white_level_dn - frame.black_level_dn))
    counts = cv2.cvtColor(frame.mosaic, _DEMOSAIC[frame.bayer_order])
    rgb = (counts.astype(np.float32) - np.float32(frame.black_level_dn)) * scale
    return LinearFrame(rgb, _clipped_neighbourhood(frame), demosaiced=True)


def _clipped_neighbourhood(frame: RawFrame) -> MaskArray:
    """Return True where a pixel's own count, or one that demosaicing mixes into it, is saturated."""
    limit = frame.black_level_dn + SATURATED * (frame.white_level_dn - frame.black_level_dn)
    clipped = (frame.mosaic >= limit).astype(np.uint8)
    return cv2.dilate(clipped, np.ones((3, 3), np.uint8)).astype(bool)


def bin_bayer(frame: RawFrame, factor: int = 2) -> LinearFrame:
    """Return linear frame of shape (H / factor, W / factor), each channel the mean of its own pixels; factor is even.

    Incomplete bins at the end are left out.
    """
    if factor < 2 or factor % 2:
        raise ValueError(f"binning factor {factor} is not a positive even number")
    rows, columns = (size // factor * factor for size in frame.shape)
    planes = np.empty((3, rows // factor, columns // factor), np.float32)
    clipped = np.empty(planes.shape[1:], np.bool_)
    for first in range(0, rows // factor, BAND_ROWS):
        band = slice(first, first + BAND_ROWS)
        mosaic = frame.mosaic[first * factor : min((first + BAND_ROWS) * factor, rows), :columns]
        _bin_band(frame, mosaic, factor, planes[:, band], clipped[band])
    return LinearFrame(np.moveaxis(planes, 0, -1), clipped)


def _bin_band(
    frame: RawFrame, mosaic: NDArray[np.uint16], factor: int, planes: Float32Array, clipped: MaskArray
) -> None:
    """Compute planes and clipping of some rows of bins from their part of the mosaic."""
    brightest = _combined(np.maximum, [mosaic[i::factor] for i in range(factor)], np.uint16)
    side = factor // 2
    fits = int(brightest.max(initial=0)) * side * side <= np.iinfo(np.uint16).max
    sums = [_summed_columns(mosaic[parity:], factor, np.uint16 if fits else np.uint32) for parity in (0, 1)]
    scale = 1.0 / (frame.white_level_dn - frame.black_level_dn)
    for plane, colour in zip(planes, "RGB", strict=True):
        sites = [divmod(i, 2) for i, letter in enumerate(frame.bayer_order) if letter == colour]
        total = _combined(np.add, [sums[row][column] for row, column in sites], np.float32)
        np.multiply(total, scale / (len(sites) * side * side), out=plane)
        plane -= np.float32(frame.black_level_dn * scale)
    limit = frame.black_level_dn + SATURATED * (frame.white_level_dn - frame.black_level_dn)
    saturated = (brightest >= math.ceil(limit)).view(np.uint16)
    np.not_equal(_combined(np.bitwise_or, [saturated[:, i::side] for i in range(side)], np.uint16), 0, out=clipped)


def _summed_columns(
    mosaic: NDArray[np.uint16], factor: int, lane: type[np.uint16 | np.uint32]
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return sums over bins of every second row from the first: of even columns, and of odd ones.

    Both arrays have the shape (H / factor, W / factor).

    Whole rows are added first, at memory speed. Then a pair of columns is viewed as one integer of twice the bits, so
    that both are added at once; `lane` is wide enough that no sum overflows into its neighbour.
    """
    down = _combined(np.add, [mosaic[i::factor] for i in range(0, factor, 2)], lane)
    pair, signed, bits = (np.uint32, np.int32, 16) if lane is np.uint16 else (np.uint64, np.int64, 32)
    pairs = down.view(pair)
    both = _combined(np.add, [pairs[:, i :: factor // 2] for i in range(factor // 2)], pair)
    first, second = both & pair((1 << bits) - 1), both >> pair(bits)
    if sys.byteorder == "big":
        first, second = second, first
    return first.view(signed), second.view(signed)


def _combined(operation: np.ufunc, parts: Sequence[NDArray[Any]], dtype: type[np.generic]) -> NDArray[Any]:
    """Elementwise sum or maximum of arrays of one shape, as a contiguous array of `dtype`."""
    if len(parts) == 1:
        return parts[0].astype(dtype)
    total: NDArray[Any] = operation(parts[0], parts[1], dtype=dtype)
    for part in parts[2:]:
        operation(total, part, out=total)
    return total


def check_exposed(frame: LinearFrame, name: str) -> None:
    """Refuse a black frame, or one that is saturated over most of its area.

    Raises
    ------
    FrameError
        Names the frame and what to check.
    """
    check_exposed_sample(frame.rgb[::EXPOSURE_STEP, ::EXPOSURE_STEP], float(frame.clipped.mean()), name)


def check_exposed_sample(sample: Float32Array, clipped_fraction: float, name: str) -> None:
    """Check every `EXPOSURE_STEP`-th row and column of a frame and its fraction of clipped pixels."""
    if float(np.percentile(sample, 99)) < BLACK_FRAME:
        raise FrameError(f"{name} is black: check that the lights are on and the lens is open, then take it again")
    if clipped_fraction > 0.5:
        raise FrameError(
            f"{name} is saturated over {clipped_fraction:.0%} of its area: lower the exposure and take it again"
        )


def make_flat_field(reference: LinearFrame) -> Float32Array:
    """Return the blurred reference: float32 array of shape (H, W, C), fraction of full scale.

    Edges of the gel at the border of the field are not blurred: they stay in place from frame to frame.
    """
    rgb = reference.rgb
    blurred = cv2.GaussianBlur(rgb, (0, 0), REFERENCE_BLUR_PX, borderType=cv2.BORDER_REFLECT).reshape(rgb.shape)
    detail = np.square(rgb / np.maximum(blurred, np.float32(DARK_FLOOR)) - np.float32(1.0)).mean(axis=-1)
    variance = cv2.GaussianBlur(detail, (0, 0), REFERENCE_BLUR_PX, borderType=cv2.BORDER_REFLECT)
    edges = large_parts(variance > np.float32(EDGE_VARIANCE) * np.median(variance), MIN_EDGE_FRACTION)
    return np.asarray(np.where(edges[..., None], rgb, blurred), np.float32)


def flat_field_correct(frame: LinearFrame, flat_field: Float32Array) -> NormalizedImage:
    """Divide a frame by a flat field (`make_flat_field` or `estimate_flat_field`).

    Raises
    ------
    CalibrationMismatch
        The frame's size differs from the reference's.
    """
    check_same_size(frame.shape, flat_field)
    lit = np.asarray((flat_field > DARK_FLOOR).all(axis=-1), np.bool_)
    values: Float32Array = np.divide(frame.rgb, np.maximum(flat_field, np.float32(DARK_FLOOR)), dtype=np.float32)
    return NormalizedImage(values, lit, frame.clipped)


def check_same_size(shape: tuple[int, ...], flat_field: Float32Array) -> None:
    """Refuse a frame of shape (H, W) with a flat field of another size.

    Raises
    ------
    CalibrationMismatch
        Names both sizes.
    """
    if shape != flat_field.shape[:2]:
        sizes = [f"{size[1]}x{size[0]}" for size in (shape, flat_field.shape)]
        turned = shape[0] == flat_field.shape[1] and shape[1] == flat_field.shape[0]
        advice = "turned by 90 degrees: turn it back" if turned else "use frames of one camera mode"
        raise CalibrationMismatch(f"the frame is {sizes[0]} pixels and the reference {sizes[1]}: {advice}")


# A flat field estimated from the frames themselves, for sets without a reference frame.


def estimate_flat_field(frames: list[LinearFrame], degree: int = 6) -> Float32Array:
    """Return a robust polynomial of log colour over position, fitted to all frames.

    Most of every frame shows untouched skin, so an iteratively reweighted fit finds it.
    Returns a float32 array of shape (H, W, N), fraction of full scale; N is the frames' number of channels.
    """
    step = max(1, int(np.sqrt(frames[0].rgb[..., 0].size * len(frames) / 60_000)))
    rows, columns = frames[0].shape
    basis_small = _position_polynomials(rows, columns, degree, step)
    channels = frames[0].rgb.shape[2]
    flat_field = np.empty((rows, columns, channels), np.float32)
    basis_row, basis_column = _chebyshev(rows, degree, 1), _chebyshev(columns, degree, 1)
    for channel in range(channels):
        samples = np.concatenate([f.rgb[::step, ::step, channel].ravel() for f in frames])
        seen = np.concatenate([~f.clipped[::step, ::step].ravel() for f in frames]) & (samples > DARK_FLOOR)
        design = np.tile(basis_small, (len(frames), 1))[seen]
        coefficients = _robust_fit(design, np.log(samples[seen]).astype(np.float64))
        surface = np.zeros((rows, columns))
        for value, (i, j) in zip(coefficients, _degrees(degree), strict=True):
            surface += value * np.outer(basis_row[:, i], basis_column[:, j])
        flat_field[..., channel] = np.exp(np.clip(surface, np.log(DARK_FLOOR / 10), 0.0))
    return flat_field


def _degrees(degree: int) -> list[tuple[int, int]]:
    return [(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)]


def _chebyshev(size: int, degree: int, step: int) -> NDArray[np.float64]:
    at = np.arange(0, size, step) * (2.0 / max(size - 1, 1)) - 1.0
    return np.polynomial.chebyshev.chebvander(at, degree)


def _position_polynomials(rows: int, columns: int, degree: int, step: int) -> NDArray[np.float64]:
    along_row, along_column = _chebyshev(rows, degree, step), _chebyshev(columns, degree, step)
    terms = [np.outer(along_row[:, i], along_column[:, j]).ravel() for i, j in _degrees(degree)]
    return np.stack(terms, axis=-1)


def _robust_fit(design: NDArray[np.float64], target: NDArray[np.float64], rounds: int = 12) -> NDArray[np.float64]:
    """Return coefficients of a Tukey-weighted least-squares fit."""
    weight = np.ones_like(target)
    coefficients: NDArray[np.float64] = np.zeros(design.shape[1])
    for _ in range(rounds):
        weighted = design * weight[:, None]
        gram = weighted.T @ design + 1e-6 * len(target) * np.eye(design.shape[1])
        coefficients = np.asarray(np.linalg.solve(gram, weighted.T @ target), np.float64)
        residual = target - design @ coefficients
        scale = 4.7 * 1.4826 * max(float(np.median(np.abs(residual))), 1e-6)
        weight[:] = np.maximum(1.0 - (residual / scale) ** 2, 0.0) ** 2
    return coefficients


# Raw frames of half the size: pixels of one colour in every 4x4 block are summed, so that a mosaic stays a mosaic.

MOVIE_BINNING: Final = 2
_BLOCK: Final = 4
_SUMMED: Final = 4
_MAX_COUNT: Final = np.iinfo(np.uint16).max


def can_bin(shape: tuple[int, int]) -> bool:
    """Return whether a frame of `shape` (H, W) consists of 4x4 blocks."""
    return shape[0] % _BLOCK == 0 and shape[1] % _BLOCK == 0


def bin_mosaic(frame: RawFrame) -> RawFrame:
    """Return the frame at half its size, each pixel the sum of four pixels of one colour.

    It is their mean where sums would not fit 16 bits.

    Raises
    ------
    ValueError
        The frame does not consist of 4x4 blocks.
    """
    rows, columns = frame.shape
    if not can_bin(frame.shape):
        raise ValueError(f"a mosaic of {columns}x{rows} pixels does not consist of 4x4 blocks")
    blocks = frame.mosaic.astype(np.uint32).reshape(rows // _BLOCK, 2, 2, columns // _BLOCK, 2, 2)
    total = blocks.sum(axis=(1, 4)).reshape(rows // 2, columns // 2)
    scale = _SUMMED if _SUMMED * frame.white_level_dn <= _MAX_COUNT else 1
    counts = total if scale == _SUMMED else (total + _SUMMED // 2) // _SUMMED
    return replace(
        frame,
        mosaic=counts.astype(np.uint16),
        black_level_dn=frame.black_level_dn * scale,
        white_level_dn=frame.white_level_dn * scale,
    )


def unbin_mosaic(frame: RawFrame) -> RawFrame:
    """Return a frame of twice the size whose pixels repeat those of a binned mosaic.

    All four pixels of one colour in a 4x4 block are alike, as `bin_mosaic` took them together. A calibration of
    full-size frames reads such a frame.
    """
    rows, columns = frame.shape
    blocks = frame.mosaic.reshape(rows // 2, 1, 2, columns // 2, 1, 2)
    whole = np.broadcast_to(blocks, (rows // 2, 2, 2, columns // 2, 2, 2))
    return replace(frame, mosaic=np.ascontiguousarray(whole).reshape(2 * rows, 2 * columns))
