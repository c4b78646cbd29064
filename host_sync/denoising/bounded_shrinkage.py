"""Strength of a calibration's shrinkage: that of the recipe, or less where it would cost fine detail.

Held-out balls are smooth and always ask for more; so what bounds the strength is what is left of fine patterns at the
calibration's own noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import msgspec
import numpy as np

from device.balls.sphere import Ball, BallSamples
from device.imaging.flat_field import NormalizedImage
from device.surface import Float32Array, Float64Array
from host_sync.denoising.frame_noise import FrameNoise, SlopeColour, measure_noise, root_of
from host_sync.denoising.wavelet_shrinkage import HALO_PX, Shrinkage, shrink_but_long_waves

THRESHOLD: Final = (1.1, 2.2, 2.2)
"""λ of each level at full strength."""

FINEST_KEPT: Final = 0.6
"""Share of the finest detail that is kept in any case, at full strength: integration removes the rest of its noise."""

STRENGTHS: Final = (1.0, 0.75, 0.5, 0.25)
BOUND_DEG: Final = 9.0
BOUND_PX: Final = 4.0
MIN_KEPT: Final = 0.6
"""Of a sinusoid of that tilt and wavelength."""

WIDEST_RIDGE_PX: Final = 2.0
"""Of a ridge of one pixel and that tilt."""


@dataclass(frozen=True, slots=True, eq=False)
class DetailShrinkage:
    """Noise of a calibration's frames and the strength of its shrinkage.

    noise : of its frames
    strength : share of the recipe's strength
    shrinkage : as the kernel takes it
    transfer : what is left of fine patterns
    """

    noise: FrameNoise
    strength: float
    shrinkage: Shrinkage
    transfer: DetailTransfer

    def shrunk(self, image: NormalizedImage) -> NormalizedImage:
        """Return the image with its noise shrunk."""
        return shrink_but_long_waves(image, self.shrinkage)

    def record(self) -> dict[str, Any]:
        """Return the entries of the calibration report."""
        return {
            "strength": self.strength,
            "noise_covariance": [[float(value) for value in row] for row in self.noise.covariance],
            "noise_variance_by_level": [float(ratio) for ratio in self.noise.ratios],
            "transfer": self.transfer,
        }


def learn_shrinkage(
    pressed: Sequence[tuple[NormalizedImage, Sequence[Ball]]],
    samples: BallSamples,
    untouched: Sequence[Float32Array],
) -> DetailShrinkage | None:
    """Return the strongest allowed shrinkage of a calibration's frames; None where their noise cannot be measured.

    pressed : intensity and balls of each press
    samples : of these balls
    untouched : as for `measure_noise`
    """
    noise = measure_noise(pressed, untouched)
    if noise is None:
        return None
    bench = TransferBench(SlopeColour.of(samples, pressed[0][0].shape), noise)
    for strength in STRENGTHS:
        shrinkage = shrinkage_of(noise, strength)
        transfer = bench.measure(shrinkage)
        if keeps_detail(transfer):
            return DetailShrinkage(noise, strength, shrinkage, transfer)
    return None


def shrinkage_of(noise: FrameNoise, strength: float) -> Shrinkage:
    """Return the shrinkage of a noise by a share of the recipe's strength."""
    kept = (1.0 - strength * (1.0 - FINEST_KEPT), 0.0, 0.0)
    return noise.shrinkage([strength * threshold for threshold in THRESHOLD], kept)


def keeps_detail(transfer: DetailTransfer) -> bool:
    """Return True if a transfer keeps what shrinkage may not cost."""
    ridge_px = transfer.ridge_px[transfer.amplitude_deg.index(BOUND_DEG)]
    widest_px = max(WIDEST_RIDGE_PX, transfer.raw_ridge_px)
    return bool(np.isfinite(ridge_px) and ridge_px <= widest_px and transfer.at(BOUND_DEG, BOUND_PX) >= MIN_KEPT)


# Fraction of a fine pattern that shrinkage keeps, by amplitude and wavelength, at a calibration's own noise.
#
# Sinusoids and ridges are drawn in the calibration's own colours, its noise is added, the frames are shrunk, and slopes
# are read back through the colours' change with slope. A sinusoid keeps what stands in phase with it, relative to the
# same reading without noise and shrinkage. A ridge's Gaussian is one pixel wide at half its height.

SINGULAR: Final = 1e12
"""Condition of the equations for slope from which they have no single solution."""

AMPLITUDES_DEG: Final = (2.2, 4.5, 9.0, 18.0)
WAVELENGTHS_PX: Final = (4.0, 6.0, 8.0, 16.0, 32.0)
TILE_PX: Final = 64
"""Side of the part of a pattern that is read."""

PLACES: Final = ((0.0, 0.0), (-0.5, -0.5), (0.5, -0.5), (-0.5, 0.5), (0.5, 0.5))
"""Position variables of the places at which patterns are drawn; every other one is turned by a right angle."""

RIDGE_SIGMA_PX: Final = 1.0 / 2.3548


class DetailTransfer(msgspec.Struct, frozen=True):
    """Fractions of fine patterns that are kept.

    amplitude_deg : steepest tilt of the patterns
    wavelength_px : of the sinusoids
    kept : share of a sinusoid's amplitude, a tuple of wavelengths for every amplitude
    ridge_px : width at half height of a ridge of one pixel, for every amplitude
    raw_ridge_px : the same without noise and shrinkage: what the pixels themselves make of it
    """

    amplitude_deg: tuple[float, ...]
    wavelength_px: tuple[float, ...]
    kept: tuple[tuple[float, ...], ...]
    ridge_px: tuple[float, ...]
    raw_ridge_px: float

    def at(self, amplitude_deg: float, wavelength_px: float) -> float:
        """Return the share kept of a sinusoid that was measured."""
        return self.kept[self.amplitude_deg.index(amplitude_deg)][self.wavelength_px.index(wavelength_px)]


class TransferBench:
    """Draws patterns and reads them back, with the same noise each time.

    Parameters
    ----------
    colour : what slopes look like
    noise : of the frames
    """

    def __init__(self, colour: SlopeColour, noise: FrameNoise) -> None:
        rng = np.random.default_rng(0)
        side = (TILE_PX + 2 * HALO_PX,) * 2
        self._colour = colour
        self._noise = noise
        self._drawn = [noise.sample(side, rng) for _ in PLACES]

    def measure(self, shrinkage: Shrinkage) -> DetailTransfer:
        """Return the transfer of a shrinkage."""
        ridges = [self._ridge_px(amplitude, shrinkage) for amplitude in AMPLITUDES_DEG]
        return DetailTransfer(
            AMPLITUDES_DEG,
            WAVELENGTHS_PX,
            tuple(tuple(self._kept(a, w, shrinkage) for w in WAVELENGTHS_PX) for a in AMPLITUDES_DEG),
            tuple(ridges),
            self._ridge_px(9.0, None),
        )

    def _kept(self, amplitude_deg: float, wavelength_px: float, shrinkage: Shrinkage) -> float:
        """Return the share of a sinusoid's amplitude that is kept."""
        wave = np.sin(2.0 * np.pi * (np.arange(_side()) - HALO_PX) / wavelength_px + 0.4)
        slope = np.tan(np.radians(amplitude_deg)) * wave
        seen, drawn = (self._read(slope, one) for one in (shrinkage, None))
        template = wave[HALO_PX:-HALO_PX] - wave[HALO_PX:-HALO_PX].mean()
        return float((seen @ template).sum() / (drawn @ template).sum())

    def _ridge_px(self, amplitude_deg: float, shrinkage: Shrinkage | None) -> float:
        """Return the mean width of a ridge on and between pixels."""
        widths = []
        for offset in (0.0, 0.5):
            across = np.arange(_side()) - _side() // 2 - offset
            bell = np.exp(-0.5 * (across / RIDGE_SIGMA_PX) ** 2)
            steepest = np.exp(-0.5) / RIDGE_SIGMA_PX
            slope = -np.tan(np.radians(amplitude_deg)) / steepest * across / RIDGE_SIGMA_PX**2 * bell
            widths.append(_width_px(self._read(slope, shrinkage).mean(axis=0)))
        return float(np.mean(widths))

    def _read(self, slope: Float64Array, shrinkage: Shrinkage | None) -> Float64Array:
        """Return slopes that are read of a profile, one row a place: float64 array of shape (places, TILE_PX).

        slope : float64 array of shape (TILE_PX + 2 HALO_PX,)
        shrinkage : None reads without noise
        """
        flat, found = np.zeros((1, len(slope))), []
        for number, place in enumerate(PLACES):
            turned = number % 2
            across, down = (flat.T, slope[:, None]) if turned else (slope[None], flat)
            root = np.broadcast_to(self._colour.root(across, down, place), (len(slope), len(slope), 3))
            if shrinkage is not None:
                root = root_of(self._shrunk(root + self._drawn[number], shrinkage))
            both = (root - self._colour.root(flat[:1, :1], flat[:1, :1], place)) @ self._slope_of_colour(place)
            read = both[..., 1].T if turned else both[..., 0]
            found.append(read[HALO_PX:-HALO_PX, HALO_PX:-HALO_PX].mean(axis=0))
        return np.stack(found)

    def _slope_of_colour(self, place: tuple[float, float]) -> Float64Array:
        """Return the factors that turn changes of colour into slopes, float64 array of shape (3, 2).

        They are those of generalised least squares.
        """
        change = self._colour.change(place)
        weighed = np.linalg.solve(self._noise.covariance, change)
        gram = change.T @ weighed
        if np.linalg.cond(gram) > SINGULAR:  # one light shows slopes in one direction only
            return np.asarray((np.linalg.pinv(gram, 1.0 / SINGULAR) @ weighed.T).T)
        return np.asarray(np.linalg.solve(gram, weighed.T).T)

    def _shrunk(self, root: Float32Array, shrinkage: Shrinkage) -> Float32Array:
        everywhere = np.ones(root.shape[:2], np.bool_)
        values = np.asarray(np.maximum(root, np.float32(0.0)) ** 2, np.float32)
        return np.ascontiguousarray(
            shrink_but_long_waves(NormalizedImage(values, everywhere, ~everywhere), shrinkage).values
        )


def _side() -> int:
    return TILE_PX + 2 * HALO_PX


def _width_px(slope: Float64Array) -> float:
    """Return the width at half height of the profile that slopes add up to.

    Slopes are summed over fourth-order edges; infinite where a side stays above half.
    """
    edges = (9.0 * (slope[1:-2] + slope[2:-1]) - (slope[:-3] + slope[3:])) / 16.0
    heights = np.concatenate([[0.0], np.cumsum(edges)])
    heights -= np.linspace(heights[0], heights[-1], len(heights))
    top = int(np.argmax(heights))
    half = 0.5 * heights[top]
    left = top - int(np.argmax(heights[top::-1] < half))
    right = top + int(np.argmax(heights[top:] < half))
    if left == top or right == top:
        return float("inf")
    rise = (half - heights[left]) / (heights[left + 1] - heights[left])
    fall = (heights[right - 1] - half) / (heights[right - 1] - heights[right])
    return float(right - 1 + fall - left - rise)
