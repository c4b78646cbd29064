"""Integrates slopes over a full rectangle with the discrete cosine transform: fast enough for the handheld.

The least-squares surface of min Σ (f_x − p)² + (f_y − q)² (paper, eq. 9) with free (Neumann) borders. Differences live
on the edges between neighbouring pixels and take the mean of the two slopes there.
"""

from __future__ import annotations

import numpy as np
from scipy.fft import dctn, idctn

from device.surface import Float32Array


def integrate_dct(p: Float32Array, q: Float32Array, pitch_um: float) -> Float32Array:
    """Height of mean zero: float32 array of shape (H, W), µm, from slopes of the same shape (µm/µm).

    pitch_um : distance of neighbouring pixels, µm
    """
    divergence = np.zeros(p.shape, np.float32)
    across = 0.5 * (p[:, 1:] + p[:, :-1])
    down = 0.5 * (q[1:] + q[:-1])
    divergence[:, :-1] -= across
    divergence[:, 1:] += across
    divergence[:-1] -= down
    divergence[1:] += down
    spectrum = dctn(divergence, type=2, norm="ortho", overwrite_x=True)
    rows, columns = (2.0 - 2.0 * np.cos(np.pi * np.arange(size) / size) for size in p.shape)
    eigenvalue = (rows[:, None] + columns[None, :]).astype(np.float32)
    eigenvalue[0, 0] = 1.0
    spectrum /= eigenvalue
    spectrum[0, 0] = 0.0
    height = idctn(spectrum, type=2, norm="ortho", overwrite_x=True)
    return np.asarray(height * np.float32(pitch_um), np.float32)
