"""Random numbers behind the Monte Carlo samples of slope errors.

They do not depend on how large errors are anywhere, so that they can be drawn before slopes are integrated.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import cv2
import numpy as np

from device.surface.fields import Float32Array
from host_sync.uncertainty.ball_gains import local_normals, shared_and_local
from host_sync.uncertainty.slope_error import SlopeError

SAMPLES: Final = 16

PLACES: Final = 48
"""Places along the field's columns at which gains of slopes are drawn."""


@dataclass(frozen=True, slots=True, eq=False)
class SlopeDraws:
    """Random numbers of mean 0 for every sample of slope errors on a reduced field (h, w).

    shared : of what errs over the whole field at once, float32 array of shape (SAMPLES, count), variance 1
    local : of gains that differ from place to place, float32 array of shape (SAMPLES, K, n, m), variance 1
    pixels : of single pixels, for slopes p and q, float32 array of shape (SAMPLES, 2, h, w), variance 1
    patches : the same over patches, of any variance
    spread : standard deviation of each field of patches, float32 array of shape (SAMPLES, 2)
    """

    shared: Float32Array
    local: Float32Array
    pixels: Float32Array
    patches: Float32Array
    spread: Float32Array


def slope_draws(error: SlopeError, size: tuple[int, int], columns: int, fields: int) -> SlopeDraws:
    """Return the random numbers for a slope error on a reduced field of `size` (w, h): the same whenever they are
    drawn, and kept for the next scan of a calibration. Nothing may be written to them.

    columns : of the field that was reduced
    fields : how many fields of slopes, each wrong all at once, are known beside what the error says
    """
    everywhere, local = shared_and_local(error.ball_gains, error.ball_places)
    patch_px = max(error.patch_px / (columns / size[0]), 0.5)
    # Beside those fields: elevation, gains everywhere, and the zero and the scale of heights.
    return _drawn(size, fields + len(everywhere) + 3, len(local), patch_px)


@lru_cache(maxsize=1)
def _drawn(size: tuple[int, int], shared_count: int, local_count: int, patch_px: float) -> SlopeDraws:
    """So many numbers that are shared by the field of `size` (w, h), and curves that are local in it."""
    rng = np.random.default_rng(0)
    shared = _normals(rng, shared_count)
    places = local_normals(rng, (SAMPLES, local_count, PLACES * size[1] // size[0] + 1, PLACES))
    pixels, patches = (np.empty((SAMPLES, 2, size[1], size[0]), np.float32) for _ in range(2))
    spread = np.empty((SAMPLES, 2), np.float32)
    for own in np.ndindex(spread.shape):
        rng.standard_normal(dtype=np.float32, out=pixels[own])
        patches[own] = cv2.GaussianBlur(rng.standard_normal(size[::-1], dtype=np.float32), (0, 0), patch_px)
        spread[own] = patches[own].std()
    for part in (shared, places, pixels, patches, spread):
        part.flags.writeable = False
    return SlopeDraws(shared, places, pixels, patches, spread)


def _normals(rng: np.random.Generator, count: int) -> Float32Array:
    """Return random numbers for every sample, mean 0 and variance 1: float32 array of shape (SAMPLES, count).

    Over the samples the first SAMPLES - 1 columns have exactly that mean and variance, and no correlation: of what errs
    over the whole field at once, 16 independent draws would tell σ to 18 % only.
    """
    normal = rng.standard_normal((SAMPLES, count))
    some = min(count, SAMPLES - 1)
    basis, sizes = np.linalg.qr(np.column_stack([np.ones(SAMPLES), normal[:, :some]]))
    # QR leaves the signs to the library; with those of the sizes every orthogonal set is as likely.
    normal[:, :some] = (basis * np.sign(np.diag(sizes)))[:, 1:] * np.sqrt(SAMPLES)
    return normal.astype(np.float32)
