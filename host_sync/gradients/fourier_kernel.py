"""The waves of a curve for a run of pixels, by a cosine written out so that the loop becomes vector instructions."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from device.inverse_map.fourier_features import RandomFourierFeatures
from device.surface.fields import Float32Array
from host_sync.integration.smoother import CONTRACT
from host_sync.kernels.jit import njit

_C0: Final = np.float32(0.99999827)
_C1: Final = np.float32(-19.738913)
_C2: Final = np.float32(64.92749)
_C3: Final = np.float32(-85.264275)
_C4: Final = np.float32(58.774754)
_C5: Final = np.float32(-21.068068)
"""cos 2πr as a polynomial in r², |r| ≤ 1/2, to 2e-6: Chebyshev's of degree 5."""

_HALF: Final = np.float32(0.5)


def tabulated_fourier_terms(waves: RandomFourierFeatures) -> Float32Array:
    """Return the direction and phase in turns: float32 array of shape (4, W)."""
    turns = np.concatenate([waves.direction, waves.phase[None]]) / np.float32(2.0 * np.pi)
    return np.ascontiguousarray(turns, np.float32)


def fourier_factor(waves: RandomFourierFeatures) -> float:
    """Return what coefficients are multiplied by for `add_fourier_terms`, which sums cosines half a turn on."""
    return -waves.amplitude


@njit(cache=True, fastmath=CONTRACT)
def add_fourier_terms(waves: Any, along: Any, x: Any, y: Any, z: Any, across: Any, u: Any, v: Any) -> None:
    """Add the waves times their coefficients, polynomials in the column's position, to both components of a run.

    waves : float32 array of shape (4, W), as tabled
    along : float32 array of shape (2, 3, W), coefficients by component and power of the column's position
    x, y, z, across, u, v : float32 arrays of shape (N,): variables, position, and the sums
    """
    for w in range(waves.shape[1]):
        kx, ky, kz, phase = waves[0, w], waves[1, w], waves[2, w], waves[3, w]
        u0, u1, u2 = along[0, 0, w], along[0, 1, w], along[0, 2, w]
        v0, v1, v2 = along[1, 0, w], along[1, 1, w], along[1, 2, w]
        for k in range(u.size):
            turns = phase + kx * x[k] + ky * y[k] + kz * z[k]
            rest = turns - np.floor(turns) - _HALF
            s = rest * rest
            cosine = _C0 + s * (_C1 + s * (_C2 + s * (_C3 + s * (_C4 + s * _C5))))
            place = across[k]
            u[k] += cosine * (u0 + place * (u1 + place * u2))
            v[k] += cosine * (v0 + place * (v1 + place * v2))
