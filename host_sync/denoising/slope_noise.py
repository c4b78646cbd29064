"""Noise of slopes, raw and shrunk, by tilt, and the share that a height map keeps; correction of the camera's blur.

Raw noise is correlated where it comes from pigment, demosaicing or compression, and shrunk noise always is: a height
map keeps another share of it than of white noise. Both shares are measured on a tile of drawn noise.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any, Final

import cv2
import numpy as np

from device.balls.sphere import BallSamples
from device.imaging.flat_field import DEMOSAIC_BLUR_PX, NormalizedImage
from device.inverse_map.model import InverseMap
from device.surface import Float32Array, Float64Array, HeightMap, integrate_dct, surface_slopes
from host_sync.denoising.frame_noise import FrameNoise, NullColour, root_of
from host_sync.denoising.wavelet_shrinkage import SPLIT_PX, Shrinkage, shrink_but_long_waves
from host_sync.integration.smoother import CONTRACT
from host_sync.kernels.jit import njit
from host_sync.kernels.parallel_rows import parallel_rows
from host_sync.results.record import SlopeNoise

TILE_PX: Final = 192
MARGIN_PX: Final = 24
"""Of the tile that is not looked at: integration has no neighbours there."""

TILT_EDGES_DEG: Final = (0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 90.0)
MAX_SAMPLES: Final = 1500
MIN_SAMPLES: Final = 50


def measure_slope_noise(
    noise: FrameNoise,
    shrinkage: Shrinkage,
    inverse_map: InverseMap,
    samples: BallSamples,
    null_colour: NullColour | None = None,
    *,
    demosaiced: bool = False,
) -> SlopeNoise:
    """Return the noise of slopes that a map reads at the places and colours of a calibration's samples.

    null_colour : takes part of it off the slopes of raw frames
    demosaiced : as of `LinearFrame`
    """
    rng = np.random.default_rng(0)
    raw = noise.sample((TILE_PX, TILE_PX), rng)
    everywhere = np.ones(raw.shape[:2], np.bool_)
    flat = NormalizedImage(np.asarray((1.0 + raw) ** 2, np.float32), everywhere, ~everywhere)
    shrunk = root_of(np.ascontiguousarray(shrink_but_long_waves(flat, shrinkage).values)) - np.float32(1.0)
    drawn = raw.reshape(-1, 3), shrunk.reshape(-1, 3)
    tilt = np.degrees(np.arctan(np.hypot(samples.p, samples.q)))
    bands: list[tuple[float, float, float]] = []
    for low, high in pairwise(TILT_EDGES_DEG):
        inside = np.flatnonzero((tilt >= low) & (tilt < high))
        if inside.size >= MIN_SAMPLES:
            some = rng.choice(inside, min(inside.size, MAX_SAMPLES), replace=False)
            both = _angles_deg(inverse_map, samples.select(some), drawn, null_colour, rng)
            bands.append((float(tilt[some].mean()), both[0], both[1]))
    tilts, raws, shrunks = zip(*(bands or [(0.0, 0.0, 0.0)]), strict=True)
    # Of raw detail what demosaicing took is restored however large its noise is, which results state.
    raw_blur_px = DEMOSAIC_BLUR_PX if demosaiced else 0.0
    raw_kept, raw_px = _in_height_map(_slopes_of_flat_skin(inverse_map, raw, shrunk, null_colour), raw_blur_px)
    shrunk_slopes = _slopes_of_flat_skin(inverse_map, shrunk, shrunk, None)
    for blur_px in ((float(np.hypot(BLUR_PX, DEMOSAIC_BLUR_PX)),) if demosaiced else ()) + (BLUR_PX, 0.0):
        shrunk_kept, shrunk_px = _in_height_map(shrunk_slopes, blur_px)
        if shrunk_kept * shrunks[0] <= MAX_NOISE_TO_SHARPEN_DEG:
            break
    return SlopeNoise(tilts, raws, shrunks, raw_kept, shrunk_kept, raw_px, shrunk_px, blur_px, raw_blur_px)


def _angles_deg(
    inverse_map: InverseMap,
    samples: BallSamples,
    drawn: tuple[Float32Array, Float32Array],
    null_colour: NullColour | None,
    rng: np.random.Generator,
) -> tuple[float, float]:
    """Return the standard deviations of the normal's angle that raw and shrunk noise cause at samples.

    They are those of either component.

    drawn : float32 arrays of shape (M, 3), both noises of the same pixels
    """
    own = rng.integers(0, len(drawn[0]), len(samples.p))
    root = root_of(samples.intensity)
    place = samples.column, samples.row
    raw, shrunk = ((root + noise[own]) ** 2 for noise in drawn)
    square = samples.p**2 + samples.q**2
    without = inverse_map.predict(root**2, *place)
    loud, quiet = _read(inverse_map, raw, shrunk, place, null_colour), inverse_map.predict(shrunk, *place)
    raw_deg, shrunk_deg = (
        float(np.degrees(((read - without) / (1.0 + square[:, None])).std())) for read in (loud, quiet)
    )
    return raw_deg, shrunk_deg


def _read(
    inverse_map: InverseMap,
    seen: Float32Array,
    shrunk: Float32Array,
    place: tuple[Float32Array, Float32Array],
    null_colour: NullColour | None,
) -> Float64Array:
    """Return slopes (N, 2) of intensities (N, 3), less what the null colour shows of their noise.

    place : columns and rows
    """
    if null_colour is None:
        return inverse_map.predict(seen, *place)
    return null_colour.read(inverse_map, seen, shrunk, *place)


def _slopes_of_flat_skin(
    inverse_map: InverseMap,
    noise: Float32Array,
    shrunk: Float32Array,
    null_colour: NullColour | None,
) -> Float32Array:
    """Return slopes of a tile (H, W, 2) that noise (H, W, 3) causes on flat skin in the middle of the field, of mean 0.

    shrunk, null_colour : what is left of that noise when it is shrunk, and what takes part of it off slopes
    """
    rows, columns = inverse_map.shape
    pixels = noise.shape[0] * noise.shape[1]
    middle = np.full(pixels, 0.5 * columns, np.float32), np.full(pixels, 0.5 * rows, np.float32)
    seen, quiet = (np.asarray((1.0 + part.reshape(-1, 3)) ** 2, np.float32) for part in (noise, shrunk))
    slopes = _read(inverse_map, seen, quiet, middle, null_colour)
    return np.asarray(slopes - slopes.mean(axis=0), np.float32).reshape(*noise.shape[:2], 2)


def _in_height_map(slopes: Float32Array, blur_px: float) -> tuple[float, float]:
    """Return the noise of a height map of a tile of flat skin whose slopes, shape (H, W, 2), are noise.

    Its slopes' share of the noise of slopes as they were read, and its heights' over its slopes', pixels; only what is
    finer than the split of raw from shrunk detail counts among heights.

    blur_px : standard deviation of the camera's blur that is taken out of such a height map
    """
    p, q = np.ascontiguousarray(slopes[..., 0]), np.ascontiguousarray(slopes[..., 1])
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


# Correction of the camera's blur.
#
# A blur of standard deviation s takes ½ s² ∇²z from heights, to first order: of a wave of 20 px 1.2 % with s = 0.5 px,
# of one of 10 px 5 %. A pixel's own square has 0.29 px; a lens that suits its pixels makes 0.5 px of it, and more is
# not known: what may be lost beyond that is in the uncertainty (`calibration_uncertainty`). Only the surface with
# shrunk detail is corrected, and only of quiet sensors: noise grows by an eighth.

BLUR_PX: Final = 0.5
"""Standard deviation of the blur that is taken out."""

MAX_NOISE_TO_SHARPEN_DEG: Final = 0.2
"""Noise of the surface's slopes up to which it is.

A real sensor with 0.38° loses 0.03° of accuracy by it, one with 0.1° nothing.
"""

REACH: Final = 2
"""Pixels between the points of a second difference: those see little of the noise from pixel to pixel."""


def without_blur(height: HeightMap, blur_px: float) -> HeightMap:
    """Return the height map less the Laplacian that a blur added; unchanged next to invalid pixels.

    blur_px : standard deviation of the blur; 0 takes nothing out
    """
    if blur_px == 0.0:
        return height
    z_um = np.ascontiguousarray(height.z_um, np.float32)
    out = np.empty_like(z_um)
    parallel_rows(_write_without, z_um.shape, z_um, np.float32(0.5 * blur_px**2 / REACH**2), out)
    return HeightMap(out, height.pitch_um)


@njit(cache=True, nogil=True)
def _write_without(z: Any, share: Any, out: Any, first: int, last: int) -> None:
    """Write rows less a share of their Laplacian; beyond the border the outermost pixels repeat."""
    rows, columns = z.shape
    for r in range(first, last):
        above, here, below = z[max(r - REACH, 0)], z[r], z[min(r + REACH, rows - 1)]
        end = max(columns - REACH, REACH)
        if end > REACH:
            inner = slice(REACH, end)
            left, right = here[: end - REACH], here[2 * REACH :]
            _write_inner(above[inner], left, here[inner], right, below[inner], share, out[r, inner])
        for c in range(columns):
            if c < REACH or c >= end:
                left_z, right_z = here[max(c - REACH, 0)], here[min(c + REACH, columns - 1)]
                out[r, c] = _less_bend(share * above[c], left_z, here[c], right_z, below[c], share)


@njit(cache=True)
def _write_inner(above: Any, left: Any, here: Any, right: Any, below: Any, share: Any, out: Any) -> None:
    for c in range(out.size):
        out[c] = _less_bend(share * above[c], left[c], here[c], right[c], below[c], share)


@njit(cache=True, fastmath=CONTRACT)
def _less_bend(begun: Any, left: Any, here: Any, right: Any, below: Any, share: Any) -> Any:
    """Return a height less its share of the Laplacian; unchanged where a neighbour is no number.

    begun : the share of the height above, rounded by itself, so that every pixel's terms are added alike
    """
    middle = np.float32(-4.0) * share
    bend = share * below + (share * right + (middle * here + (share * left + begun)))
    return here - (bend if np.isfinite(bend) else np.float32(0.0))
