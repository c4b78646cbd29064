"""The pattern of the skin's pigment: where a frame shows it, how strongly, and how sharply.

Pigment, dust and the sensor's own pattern multiply the light, whatever the skin's slope and however strong the lights
are: a frame of the same skin and camera shows the reference's pattern at its place. How strongly is a regression,

    b(x) = a r(x - s) + noise,    weights 1 / local variance of b,

of the frame's band b on the reference's r. A blur of standard deviation β lowers a in the fine band more than in the
coarse one, whatever else changes; that both bands are of the same frame makes their ratio a measure of β alone.

Bands are compared in windows spread over the field. They lie symmetrically about the field's centre, so that the
windows of a turned or mirrored frame are the turned or mirrored windows.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import fft

from device.imaging.flat_field import DARK_FLOOR, NormalizedImage
from device.surface import Float32Array

SIDE_PX: Final = 128
MAX_ACROSS: Final = 8
MAX_DOWN: Final = 6

BAND_PX: Final = (1.0, 2.0, 4.0)
"""Standard deviations of the Gaussians whose differences are the fine and the coarse band, pixels."""

EDGE_PX: Final = 8
"""So many pixels along a window's border are left out: the Gaussians mix in what lies beside it."""

VARIANCE_PX: Final = 17
"""Side of the box over which a band's local variance is taken, pixels."""

VARIANCE_FLOOR: Final = 0.25
CLIP_SIGMAS: Final = 3.0
"""Local variances below this share of their median count as that much; values beyond so many of their standard
deviations are cut: an edge of the object must not outweigh the pattern."""


@dataclass(frozen=True, slots=True)
class WindowGrid:
    """First pixels of the windows of a field of shape (H, W).

    rows, columns : of each window's first pixel
    side : of a window, pixels
    """

    rows: tuple[int, ...]
    columns: tuple[int, ...]
    side: int

    @classmethod
    def of(cls, shape: tuple[int, int]) -> WindowGrid:
        """Return the grid of a field; windows of small fields are smaller, so that there are at least two by two."""
        side = min(SIDE_PX, min(shape) // 2)
        down, across = (min(most, size // side) for most, size in ((MAX_DOWN, shape[0]), (MAX_ACROSS, shape[1])))
        return cls(_starts(shape[0], down, side), _starts(shape[1], across, side), side)

    @property
    def count(self) -> int:
        """Number of windows."""
        return len(self.rows) * len(self.columns)


def _starts(size: int, count: int, side: int) -> tuple[int, ...]:
    """Return the first pixels of `count` windows, the last mirrored to the first about the middle."""
    half = [round(i * (size - side) / (count - 1)) for i in range((count + 1) // 2)]
    return tuple(half + [size - side - half[i] for i in reversed(range(count // 2))])


def window_light(image: NormalizedImage, flat_field: Float32Array, grid: WindowGrid) -> Float32Array:
    """Return the log of the light of all channels in the windows, laid side by side.

    Float32 array of shape (rows · side, columns · side).

    flat_field : float32 array of shape (H, W, 3), what the frame was divided by
    """
    side = grid.side
    light = np.empty((len(grid.rows) * side, len(grid.columns) * side), np.float32)
    for i, row in enumerate(grid.rows):
        for j, column in enumerate(grid.columns):
            here = (slice(row, row + side), slice(column, column + side))
            light[i * side : (i + 1) * side, j * side : (j + 1) * side] = np.einsum(
                "ijc,ijc->ij", image.values[here], flat_field[here]
            )
    return np.asarray(np.log(np.maximum(light, np.float32(3.0 * DARK_FLOOR))), np.float32)


def light_bands(light: Float32Array) -> tuple[Float32Array, Float32Array]:
    """Return the fine and the coarse band of log light, arrays of its shape."""
    blurred = [cv2.GaussianBlur(light, (0, 0), sigma) for sigma in BAND_PX]
    return np.asarray(blurred[0] - blurred[1], np.float32), np.asarray(blurred[1] - blurred[2], np.float32)


def weighted(band: Float32Array) -> tuple[Float32Array, Float32Array]:
    """Return a band over its local variance, its large values cut, and one over that variance: arrays of its shape."""
    variance = cv2.blur(band * band, (VARIANCE_PX, VARIANCE_PX))
    floor = VARIANCE_FLOOR * float(np.median(variance[::4, ::4]))
    weight = np.float32(1.0) / np.maximum(variance, np.float32(max(floor, 1e-12)))
    reach = np.float32(CLIP_SIGMAS) / np.sqrt(weight)
    return np.asarray(np.clip(band, -reach, reach) * weight, np.float32), np.asarray(weight, np.float32)


def in_windows(laid: Float32Array, grid: WindowGrid) -> Float32Array:
    """Return windows laid side by side as an array of shape (N, side, side), zero along each window's border."""
    side = grid.side
    down, across = len(grid.rows), len(grid.columns)
    windows = laid.reshape(down, side, across, side).swapaxes(1, 2).reshape(down * across, side, side)
    inner = np.zeros((side, side), np.float32)
    inner[EDGE_PX:-EDGE_PX, EDGE_PX:-EDGE_PX] = 1.0
    return np.asarray(windows * inner, np.float32)


REACH_FRACTION: Final = 0.25
"""Shifts are searched up to this share of a window's side."""


@dataclass(frozen=True, slots=True)
class PatternSight:
    """Place and strength of the reference's pattern in a frame.

    row_px, column_px : where it lies, against the reference
    sigmas : height of that correlation peak, in standard deviations of the correlation elsewhere
    fine, coarse : amplitude of the pattern in the two bands, 1 in a reference without noise
    fine_sigma, coarse_sigma : their standard uncertainties
    """

    row_px: int
    column_px: int
    sigmas: float
    fine: float
    coarse: float
    fine_sigma: float
    coarse_sigma: float

    @property
    def distance_px(self) -> float:
        """Distance of the pattern from its place."""
        return float(np.hypot(self.row_px, self.column_px))


@dataclass(frozen=True, slots=True, eq=False)
class Correlation:
    """A frame's correlation with the reference, one map a band.

    numerators : float32 arrays of shape (side, side), by shift, shift 0 at the first element
    power : Σ w r² of each band
    noise : standard deviation of each numerator away from any peak
    """

    numerators: tuple[Float32Array, Float32Array]
    power: tuple[float, float]
    noise: tuple[float, float]

    def peak(self, within_px: float) -> PatternSight:
        """Return the highest peak up to `within_px` from zero shift."""
        fine, coarse = self.numerators
        sum_sigmas = (fine / self.noise[0] + coarse / self.noise[1]) / np.sqrt(2.0)
        shift = fft.fftfreq(len(fine), 1.0 / len(fine))
        far = np.hypot(shift[:, None], shift[None, :]) > within_px
        at = np.unravel_index(int(np.where(far, -np.inf, sum_sigmas).argmax()), far.shape)
        return PatternSight(
            row_px=int(shift[at[0]]),
            column_px=int(shift[at[1]]),
            sigmas=float(sum_sigmas[at]),
            fine=float(fine[at]) / self.power[0],
            coarse=float(coarse[at]) / self.power[1],
            fine_sigma=self.noise[0] / self.power[0],
            coarse_sigma=self.noise[1] / self.power[1],
        )


@dataclass(frozen=True, slots=True, eq=False)
class ReferencePattern:
    """The pattern of a reference frame.

    grid : the windows
    squares : float32 arrays of shape (N, side, side), each band squared
    spectra : complex64 arrays of shape (N, side, side // 2 + 1), conjugate Fourier transforms of each band
    """

    grid: WindowGrid
    squares: tuple[Float32Array, Float32Array]
    spectra: tuple[NDArray[np.complex64], NDArray[np.complex64]]

    @classmethod
    def of(cls, intensity: NormalizedImage, flat_field: Float32Array) -> ReferencePattern:
        """Return the pattern of the reference's own intensity; `flat_field` is a float32 array of shape (H, W, 3)."""
        grid = WindowGrid.of(intensity.shape)
        fine, coarse = (in_windows(band, grid) for band in light_bands(window_light(intensity, flat_field, grid)))
        return cls(grid, (fine * fine, coarse * coarse), (_spectrum(fine).conj(), _spectrum(coarse).conj()))

    @property
    def reach_px(self) -> float:
        """Farthest shift that is searched."""
        return REACH_FRACTION * self.grid.side

    def light(self, intensity: NormalizedImage, flat_field: Float32Array) -> Float32Array:
        """Return a frame's log light in the windows, laid side by side."""
        return window_light(intensity, flat_field, self.grid)

    def correlate(self, light: Float32Array) -> Correlation:
        """Return the correlation of log light in the windows with the pattern."""
        maps, powers, noises = [], [], []
        for band, square, spectrum in zip(light_bands(light), self.squares, self.spectra, strict=True):
            scaled, weight = weighted(band)
            total = np.einsum("nij,nij->ij", _spectrum(in_windows(scaled, self.grid)), spectrum)
            found = np.asarray(fft.irfft2(total, s=(self.grid.side, self.grid.side)), np.float32)
            maps.append(found)
            powers.append(max(float(np.vdot(in_windows(weight, self.grid), square)), 1e-12))
            noises.append(max(1.4826 * float(np.median(np.abs(found - np.median(found)))), 1e-12))
        return Correlation((maps[0], maps[1]), (powers[0], powers[1]), (noises[0], noises[1]))


def _spectrum(windows: Float32Array) -> NDArray[Any]:
    return np.asarray(fft.rfft2(windows))
