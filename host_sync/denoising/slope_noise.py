"""What the frames' noise does to slopes, raw and shrunk, by tilt, and how much of it a height map keeps.

Raw noise is correlated where it comes from pigment, demosaicing or compression, and shrunk noise always is: a height
map keeps another share of it than of white noise. Both shares are measured on a tile of drawn noise.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Final

import cv2
import numpy as np

from device.balls.sphere import BallSamples
from device.imaging.flat_field import DEMOSAIC_BLUR_PX, NormalizedImage
from device.inverse_map.model import InverseMap
from device.surface.fields import Float32Array, Float64Array, HeightMap, surface_slopes
from device.surface.poisson_dct import integrate_dct
from host_sync.denoising.blur_correction import BLUR_PX, MAX_NOISE_DEG, without_blur
from host_sync.denoising.frame_noise import FrameNoise, root_of
from host_sync.denoising.long_waves import shrink_but_long_waves
from host_sync.denoising.wavelet_shrinkage import SPLIT_PX, Shrinkage
from host_sync.results.record import SlopeNoise

TILE_PX: Final = 192
MARGIN_PX: Final = 24
"""Of the tile that is not looked at: integration has no neighbours there."""

TILT_EDGES_DEG: Final = (0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 90.0)
MAX_SAMPLES: Final = 1500
MIN_SAMPLES: Final = 50


def measure_slope_noise(
    noise: FrameNoise, shrinkage: Shrinkage, inverse_map: InverseMap, samples: BallSamples, *, demosaiced: bool = False
) -> SlopeNoise:
    """The noise of slopes that a map reads at the places and colours of a calibration's samples.

    demosaiced : as of `LinearFrame`
    """
    rng = np.random.default_rng(0)
    raw = noise.sample((TILE_PX, TILE_PX), rng)
    everywhere = np.ones(raw.shape[:2], np.bool_)
    flat = NormalizedImage(np.asarray((1.0 + raw) ** 2, np.float32), everywhere, ~everywhere)
    shrunk = root_of(np.ascontiguousarray(shrink_but_long_waves(flat, shrinkage).values)) - np.float32(1.0)
    tilt = np.degrees(np.arctan(np.hypot(samples.p, samples.q)))
    bands: list[tuple[float, float, float]] = []
    for low, high in pairwise(TILT_EDGES_DEG):
        inside = np.flatnonzero((tilt >= low) & (tilt < high))
        if inside.size >= MIN_SAMPLES:
            some = rng.choice(inside, min(inside.size, MAX_SAMPLES), replace=False)
            both = [_angle_deg(inverse_map, samples, some, part, rng) for part in (raw, shrunk)]
            bands.append((float(tilt[some].mean()), both[0], both[1]))
    tilts, raws, shrunks = zip(*(bands or [(0.0, 0.0, 0.0)]), strict=True)
    # Of raw detail what demosaicing took is given back however loud its noise is, which is known and told.
    raw_blur_px = DEMOSAIC_BLUR_PX if demosaiced else 0.0
    raw_kept, raw_px = _in_height_map(inverse_map, raw, raw_blur_px)
    for blur_px in ((float(np.hypot(BLUR_PX, DEMOSAIC_BLUR_PX)),) if demosaiced else ()) + (BLUR_PX, 0.0):
        shrunk_kept, shrunk_px = _in_height_map(inverse_map, shrunk, blur_px)
        if shrunk_kept * shrunks[0] <= MAX_NOISE_DEG:
            break
    return SlopeNoise(tilts, raws, shrunks, raw_kept, shrunk_kept, raw_px, shrunk_px, blur_px, raw_blur_px)


def _angle_deg(
    inverse_map: InverseMap,
    samples: BallSamples,
    some: np.ndarray[tuple[int], np.dtype[np.intp]],
    noise: Float32Array,
    rng: np.random.Generator,
) -> float:
    """Standard deviation of the normal's angle, either component, that noise causes at some samples."""
    own = noise.reshape(-1, 3)[rng.integers(0, noise.shape[0] * noise.shape[1], some.size)]
    root = root_of(samples.intensity[some])
    place = samples.column[some], samples.row[some]
    apart = inverse_map.predict((root + own) ** 2, *place) - inverse_map.predict(root**2, *place)
    square = samples.p[some] ** 2 + samples.q[some] ** 2
    return float(np.degrees((apart / (1.0 + square[:, None])).std()))


def _in_height_map(inverse_map: InverseMap, noise: Float32Array, blur_px: float) -> tuple[float, float]:
    """Noise of a height map of flat skin in the middle of the field.

    Its slopes' share of the noise of slopes as they were read, and its heights' over its slopes', pixels; only what is
    finer than the split of raw from shrunk detail counts among heights.

    blur_px : standard deviation of the camera's blur that is taken out of such a height map
    """
    rows, columns = inverse_map.shape
    side = noise.shape[0]
    middle = np.full(side * side, 0.5 * columns, np.float32), np.full(side * side, 0.5 * rows, np.float32)
    slopes = inverse_map.predict(np.asarray((1.0 + noise.reshape(-1, 3)) ** 2, np.float32), *middle)
    fields = (slopes - slopes.mean(axis=0)).astype(np.float32).reshape(side, side, 2)
    p, q = fields[..., 0], fields[..., 1]
    coarse_and_fine = integrate_dct(p, q, 1.0)
    coarse_and_fine = without_blur(HeightMap(coarse_and_fine, 1.0), blur_px).z_um
    heights = np.asarray(coarse_and_fine - cv2.GaussianBlur(coarse_and_fine, (0, 0), SPLIT_PX), np.float32)
    across, down = surface_slopes(HeightMap(heights, 1.0))
    inner = (slice(MARGIN_PX, -MARGIN_PX),) * 2
    slope = max(_spread(across[inner], down[inner]), 1e-12)
    height_px = float(np.std(heights[inner]))
    return slope / max(_spread(p[inner], q[inner]), 1e-12), height_px / slope


def _spread(p: Float32Array | Float64Array, q: Float32Array | Float64Array) -> float:
    return float(np.sqrt(0.5 * (p.var() + q.var())))
