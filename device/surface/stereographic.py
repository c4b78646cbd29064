"""Stereographic slope u = 2 (p, q) / (1 + sqrt(1 + p² + q²)), the target of the fits instead of (p, q).

It stays bounded for steep slopes, so that steep pixels do not dominate a least-squares fit.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def slope_from_stereographic(u: NDArray[Any]) -> NDArray[Any]:
    """(p, q) of shape (..., 2) from stereographic slopes; |u| is clamped to 1.9 (slope 19.5)."""
    square = np.minimum((u * u).sum(axis=-1, keepdims=True), 3.61)
    return np.asarray(u / (1.0 - 0.25 * square))


def stereographic_from_slope(p: NDArray[Any], q: NDArray[Any]) -> NDArray[Any]:
    """Return the stereographic slopes of shape (N, 2)."""
    scale = 2.0 / (1.0 + np.sqrt(1.0 + p * p + q * q))
    return np.asarray(np.stack([p, q], axis=-1) * scale[..., None])
