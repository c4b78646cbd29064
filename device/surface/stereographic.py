"""Stereographic slope u = 2 (p, q) / (1 + sqrt(1 + p² + q²)), the target of the fits instead of (p, q).

It stays bounded for steep slopes, so that steep pixels do not dominate a least-squares fit.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def slope_from_stereographic(u: NDArray[Any], steepest: float = 20.0) -> NDArray[Any]:
    """Return slopes (p, q) of shape (..., 2) from stereographic slopes; steeper ones become as steep as `steepest`."""
    size, largest = np.sqrt((u * u).sum(axis=-1, keepdims=True)), stereographic_size(steepest)
    held = largest / np.maximum(size, largest)
    return np.asarray(held * u / (1.0 - 0.25 * np.minimum(size, largest) ** 2))


def stereographic_size(steepness: float) -> float:
    """Return the size of the stereographic slope of a slope."""
    return 2.0 * steepness / (1.0 + float(np.sqrt(1.0 + steepness * steepness)))


def stereographic_from_slope(p: NDArray[Any], q: NDArray[Any]) -> NDArray[Any]:
    """Return the stereographic slopes of shape (N, 2)."""
    scale = 2.0 / (1.0 + np.sqrt(1.0 + p * p + q * q))
    return np.asarray(np.stack([p, q], axis=-1) * scale[..., None])
