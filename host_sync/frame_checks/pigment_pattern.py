"""The pattern of the skin's pigment: where a frame shows it, how strongly, and how sharply.

Pigment, dust and the sensor's own pattern multiply the light, whatever the skin's slope and however strong the lights
are: a frame of the same skin and camera shows the reference's pattern at its place. How strongly is a regression,

    b(x) = a r(x - s) + noise,    weights 1 / local variance of b,

of the frame's band b on the reference's r. A blur of standard deviation β lowers a in the fine band more than in the
coarse one, whatever else changes; that both bands are of the same frame makes their ratio a measure of β alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from device.imaging.flat_field import NormalizedImage
from device.surface.fields import Float32Array
from host_sync.frame_checks.pattern_windows import WindowGrid, in_windows, light_bands, weighted, window_light

REACH_SHARE: Final = 0.25
"""Shifts are searched up to this share of a window's side."""


@dataclass(frozen=True, slots=True)
class PatternSight:
    """What a frame shows of the reference's pattern.

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
        """How far from its place the pattern lies."""
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
        """The highest peak up to `within_px` from zero shift."""
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
        """The pattern of the reference's own intensity image, float32 `divisor` of shape (H, W, 3)."""
        grid = WindowGrid.of(intensity.shape)
        fine, coarse = (in_windows(band, grid) for band in light_bands(window_light(intensity, flat_field, grid)))
        return cls(grid, (fine * fine, coarse * coarse), (_spectrum(fine).conj(), _spectrum(coarse).conj()))

    @property
    def reach_px(self) -> float:
        """Farthest shift that is searched."""
        return REACH_SHARE * self.grid.side

    def light(self, intensity: NormalizedImage, flat_field: Float32Array) -> Float32Array:
        """A frame's log light in the windows, laid side by side."""
        return window_light(intensity, flat_field, self.grid)

    def correlate(self, light: Float32Array) -> Correlation:
        """The correlation of log light in the windows with the pattern."""
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
