"""Integrates slopes over a full rectangle with the discrete cosine transform: fast enough for the handheld.

The result is the least-squares surface of min Σ (f_x − p)² + (f_y − q)² (paper, eq. 9) with free (Neumann) borders.
Differences are defined on the edges between neighbouring pixels, where the slope is the mean of the two pixels'.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.fft import dctn, idctn

from device.surface.fields import Float32Array, Float64Array


def integrate_dct(p: Float32Array, q: Float32Array, pitch_um: float) -> Float32Array:
    """Return the height with mean zero: float32 array of shape (H, W), µm, from slopes of the same shape (µm/µm).

    pitch_um : distance of neighbouring pixels, µm
    """
    # Twice the divergence: slopes of the edges left of and above a pixel minus those of the edges after it.
    divergence = np.empty(p.shape, np.float32)
    np.subtract(p[:, :-2], p[:, 2:], out=divergence[:, 1:-1])
    divergence[:, 0] = -(p[:, 0] + p[:, 1])
    divergence[:, -1] = p[:, -2] + p[:, -1]
    divergence[1:-1] += q[:-2] - q[2:]
    divergence[0] -= q[0] + q[1]
    divergence[-1] += q[-2] + q[-1]
    spectrum = dctn(divergence, type=2, norm="ortho", overwrite_x=True)
    spectrum *= _inverse_eigenvalues(p.shape, pitch_um)
    return np.asarray(idctn(spectrum, type=2, norm="ortho", overwrite_x=True), np.float32)


@lru_cache(maxsize=2)
def _inverse_eigenvalues(shape: tuple[int, ...], pitch_um: float) -> Float32Array:
    """Return the height per unit of twice the divergence, µm, for each cosine: float32 array (H, W); 0 for the mean."""
    return np.asarray(0.5 * pitch_um / eigenvalues(shape), np.float32)


def eigenvalues(shape: tuple[int, ...]) -> Float64Array:
    """Return the eigenvalue of the least-squares operator for each cosine: float64 array of shape (H, W).

    The zero eigenvalue of the mean is replaced by infinity, so that dividing by these gives heights with mean zero.
    """
    rows, columns = (2.0 - 2.0 * np.cos(np.pi * np.arange(size) / size) for size in shape)
    eigenvalue = np.add.outer(rows, columns)
    eigenvalue[0, 0] = np.inf
    return np.asarray(eigenvalue)
