"""Surfaces that the data allow: the height map plus one sample of its error at a time.

A number's uncertainty is the spread of what it becomes on these surfaces, each levelled, filtered and measured as the
height map itself is; no formula per pixel can give it, as errors are correlated over the field.

Scale: what was measured of pixel pitch and ball radius is in the samples' heights already. Lengths along the skin get
the pitch's share here. What was not measured but is stated in the recipe is added here, to heights (two shares of the
pitch, one of the radius) and to lengths alike, from one random number, so that a quantity that depends on both sees it
as it is.

Surfaces unlike the balls: a calibration measures its errors on balls, and a ball shows shallow slopes at its apex only.
On a raised flat face shallow slopes are read with another gain. That error is the same all over a press, no sample of
the reconstruction holds it, and it is larger than all of them: it is added here as a fraction of the heights.

Fine noise: a cell of the samples covers several pixels. Slope uncertainty beyond the slopes of the samples is noise
from pixel to pixel; integration turns it into heights that are correlated over a few pixels only. One periodic tile of
such noise is made: white slopes, integrated by least squares, minus the part that the cells represent. Each sample lays
it over the field at a random place, scaled by the missing uncertainty.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Final

import cv2
import msgspec
import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.stats import norm

from device.surface import Float32Array, Float64Array
from host_sync.results.reader import ResultSurface
from host_sync.results.record import HEIGHT_PER_PITCH

TILE_PX: Final = 512
SMOOTHINGS_PX: Final = (0.5, 0.7, 1.0, 1.4, 2.0)
"""Standard deviations of the Gaussians that make white noise as smooth as measured noise is."""

SMOOTH_CELLS: Final = 4.0
"""Standard deviation of the Gaussian that smooths the slope variance of the samples, cells."""


class FineNoise:
    """Noise at scales between a pixel and a cell of the samples.

    Parameters
    ----------
    slope_sigma : float32 array of shape (H, W), standard uncertainty of either slope, NaN where invalid
    samples_um : float32 array of shape (K, h, w)
    pitch_um : pixel pitch, µm
    height_px : measured noise of heights over noise of slopes, pixels; correlated noise has more
    """

    def __init__(
        self,
        slope_sigma: Float32Array,
        samples_um: Float32Array,
        pitch_um: float,
        height_px: float | None = None,
    ) -> None:
        rows, columns = slope_sigma.shape
        cell_px = columns / samples_um.shape[2]
        square = _slope_square(samples_um, cell_px * pitch_um)
        held = cv2.resize(square, (columns, rows), interpolation=cv2.INTER_LINEAR)
        missing = np.sqrt(np.maximum(np.nan_to_num(slope_sigma) ** 2 - held, np.float32(0.0)))
        self._scale_um = np.asarray(missing * np.float32(pitch_um), np.float32)
        self._tile = _unit_tile(round(cell_px), height_px)

    def sample_um(self, rng: np.random.Generator) -> Float32Array:
        """Return one sample: float32 array of shape (H, W), µm."""
        tile = np.roll(self._tile, rng.integers(0, TILE_PX, 2), (0, 1))
        if rng.integers(2):
            tile = tile.T
        rows, columns = self._scale_um.shape
        repeats = (-(-rows // TILE_PX), -(-columns // TILE_PX))
        return np.asarray(np.tile(tile, repeats)[:rows, :columns] * self._scale_um, np.float32)


def _slope_square(samples_um: Float32Array, cell_um: float) -> Float32Array:
    """Return the mean square of either slope over the samples: float32 array of shape (h, w)."""
    total = np.zeros(samples_um.shape[1:], np.float32)
    for sample_um in samples_um:
        q, p = np.gradient(sample_um / np.float32(cell_um))
        total += (p * p + q * q) / np.float32(2 * len(samples_um))
    return np.asarray(cv2.GaussianBlur(total, (0, 0), SMOOTH_CELLS), np.float32)


def _unit_tile(cell_px: int, height_px: float | None) -> Float32Array:
    """Periodic heights (pixels) whose central differences have standard deviation 1: float32 array (TILE, TILE).

    height_px : standard deviation that the heights come to by smoothing; as white slopes make it where it is smaller
    """
    rng = np.random.default_rng(0)
    p, q = (np.fft.rfft2(rng.standard_normal((TILE_PX, TILE_PX))) for _ in range(2))
    across = 2j * np.sin(np.pi * np.fft.rfftfreq(TILE_PX))
    down = 2j * np.sin(np.pi * np.fft.fftfreq(TILE_PX))[:, None]
    square = np.abs(across) ** 2 + np.abs(down) ** 2
    square[0, 0] = 1.0
    heights = np.fft.irfft2((np.conj(across) * p + np.conj(down) * q) / square, (TILE_PX, TILE_PX)).astype(np.float32)
    coarse = cv2.resize(heights, (TILE_PX // cell_px,) * 2, interpolation=cv2.INTER_AREA)
    fine = heights - cv2.resize(coarse, (TILE_PX, TILE_PX), interpolation=cv2.INTER_LINEAR)
    tile = _of_unit_slope(fine)
    for sigma_px in SMOOTHINGS_PX if height_px else ():
        if float(tile.std()) >= (height_px or 0.0):
            break
        tile = _of_unit_slope(np.asarray(gaussian_filter(fine, sigma_px, mode="wrap"), np.float32))
    return tile


def _of_unit_slope(heights: Float32Array) -> Float32Array:
    slopes = [np.roll(heights, -1, axis) - np.roll(heights, 1, axis) for axis in (0, 1)]
    return np.asarray(heights / (0.5 * np.sqrt(np.mean(np.square(slopes)))), np.float32)


SEED: Final = 25178

UNLIKE_BALLS_SIGMA: Final = 0.02
"""Of heights on surfaces that no ball is like: steps, grooves, planes and waves over 10 px are 0.2, 0.3, 0.4 and 0.7 %
off in the mean on four rendered sensors, at worst 0.4, 0.9, 0.8 and 1.9 % on one of them (docs/accuracy.md); what an
instrument of your own does, a certified step shows."""

NOISE_DRAWS: Final = 4
"""How often pixel noise is added once more to see what it does to a number: it is an average over many pixels."""

NOISE_CELL_PX: Final = 16
"""Pixel noise that is coarser than two of such cells is not looked at: no roughness filter would leave it."""

Share = Annotated[float, msgspec.Meta(ge=0, lt=1)]


class StatedScale(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Standard uncertainties, as shares, that the calibration did not measure; None leaves them out.

    unlike_balls_share : of heights on surfaces that no ball is like; 0.02 holds a ball's own radius
    """

    pixel_pitch_share: Share | None = None
    ball_radius_share: Share | None = None
    unlike_balls_share: Share = UNLIKE_BALLS_SIGMA


@dataclass(frozen=True, slots=True, eq=False)
class SampledSurface:
    """One surface that the data allow.

    z_um : float32 array of shape (H, W)
    stretch : by what factor lengths along the skin are longer than the nominal pitch makes them
    """

    z_um: Float32Array
    stretch: float


class HeightSamples:
    """The samples of one result; each is made when it is asked for, and one alone is held.

    Parameters
    ----------
    surface : the result
    stated : what its calibration did not measure
    """

    def __init__(self, surface: ResultSurface, stated: StatedScale | None = None) -> None:
        self._z_um = surface.height.z_um
        samples_um = surface.samples_um
        self._samples_um = samples_um if samples_um is not None else np.zeros((0, 1, 1), np.float32)
        self._fine = None
        if surface.slope_sigma is not None and samples_um is not None and samples_um.shape[2] < self._z_um.shape[1]:
            self._fine = FineNoise(surface.slope_sigma, samples_um, surface.height.pitch_um, surface.noise_height_px)
        self._pixel_noise = None
        noise_sigma = surface.pixel_noise_sigma()
        if noise_sigma is not None:
            cells = (max(size // NOISE_CELL_PX, 1) for size in noise_sigma.shape)
            nothing = np.zeros((1, *cells), np.float32)
            self._pixel_noise = FineNoise(noise_sigma, nothing, surface.height.pitch_um, surface.noise_height_px)
        known, stated = surface.record.height_scale, stated or StatedScale()
        rng = np.random.default_rng(SEED)
        pitch, radius, unlike = (_balanced(rng, len(self)) for _ in range(3))
        self._height_factor = 1.0 + stated.unlike_balls_share * unlike
        self._stretch = 1.0 + (known.pixel_pitch_share or stated.pixel_pitch_share or 0.0) * pitch
        if known.pixel_pitch_share is None:
            self._height_factor += HEIGHT_PER_PITCH * (stated.pixel_pitch_share or 0.0) * pitch
        if known.ball_radius_share is None:
            self._height_factor += (stated.ball_radius_share or 0.0) * radius

    def __len__(self) -> int:
        return len(self._samples_um)

    def noisier(self) -> Iterator[Float32Array]:
        """Yield the height map with its pixel noise once more, `NOISE_DRAWS` times: float32 arrays of shape (H, W), µm.

        None of raw detail whose noise the result does not state, none of shrunk detail.
        """
        rng = np.random.default_rng(SEED + 2)
        if self._pixel_noise is not None:
            for _ in range(NOISE_DRAWS):
                yield self._z_um + self._pixel_noise.sample_um(rng)

    def surfaces(self) -> Iterator[SampledSurface]:
        """Yield every surface, one after the other; the same ones at each call."""
        size = (self._z_um.shape[1], self._z_um.shape[0])
        rng = np.random.default_rng(SEED + 1)
        for sample_um, factor, stretch in zip(self._samples_um, self._height_factor, self._stretch, strict=True):
            z_um = self._z_um + np.asarray(cv2.resize(sample_um, size, interpolation=cv2.INTER_LINEAR), np.float32)
            if self._fine is not None:
                z_um += self._fine.sample_um(rng)
            z_um *= np.float32(factor)
            yield SampledSurface(z_um, float(stretch))


def _balanced(rng: np.random.Generator, count: int) -> Float64Array:
    """Return normal numbers in random order, of mean 0 and mean square 1 exactly.

    Even few samples then have the standard deviation that is stated.
    """
    if count < 2:
        return np.zeros(count)
    quantiles = norm.ppf((np.arange(count) + 0.5) / count)
    return rng.permutation(quantiles / quantiles.std())
