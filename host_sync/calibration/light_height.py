"""How high the lights stand over the skin, as balls in different places tell it.

Under a point at the height h over the place (X, Y) a matt skin of slope g shows, divided by its reference,
I √(1 + |g|²) = 1 + a·g with a = (x - X, y - Y) / h: from pixel to pixel a changes by 1 / h, the same in every channel
and in mixtures of lights. That one number is asked for: four balls tell it. Directions that bend freely over the field,
as in `device.near_field`, leave it to chance with fewer than twelve.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from device.ball import BallSamples
from device.near_field import GENTLE

MOST_SAMPLES: Final = 20_000
FEWEST_SAMPLES: Final = 100


def nearness_per_px(taught: BallSamples) -> float:
    """One over the height of the lights, per pixel; 0 for lights far away and where no slope is gentle."""
    gentle = np.flatnonzero(np.hypot(taught.p, taught.q) < GENTLE)
    if gentle.size < FEWEST_SAMPLES:
        return 0.0
    rows = gentle[:: max(1, gentle.size // MOST_SAMPLES)]
    p, q, column, row = (part[rows].astype(np.float64) for part in (taught.p, taught.q, taught.column, taught.row))
    brightness = taught.intensity[rows] * np.sqrt(1.0 + p**2 + q**2)[:, None]
    reach = (column - column.mean()) * p + (row - row.mean()) * q
    alike, _ = np.linalg.qr(np.stack([np.ones_like(p), p, q], axis=-1))  # what lights far away explain
    reach -= alike @ (alike.T @ reach)
    return max(float((reach @ brightness).mean() / max(reach @ reach, 1e-12)), 0.0)
