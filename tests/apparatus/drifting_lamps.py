"""Frames of untouched skin and a dome under lamps that drifted, and a map that reads them as they were drawn."""

from __future__ import annotations

import numpy as np

from device.imaging.flat_field import NormalizedImage

SHAPE = (240, 320)
ROW, COLUMN = (axis.astype(float) for axis in np.mgrid[: SHAPE[0], : SHAPE[1]])
ANSWER = np.array([[1.0, -0.5, -0.5], [0.0, 0.8, -0.8]])
"""Change of the three channels' log light with slopes p and q."""

NOISE = 0.005
DRIFT = np.array([-0.02, 0.0, 0.01])


class LinearMap:
    """Reads slopes of three channels as `ANSWER` has them."""

    def on_grid(self, values: np.ndarray, _column: np.ndarray, _row: np.ndarray) -> np.ndarray:
        return (np.log(values) @ np.linalg.pinv(ANSWER)).astype(np.float32)


MAP = LinearMap()


def frame(drift: np.ndarray, seed: int = 0, *, dome: float = 1.0, clipped: bool = False) -> NormalizedImage:
    """A dome of 40 px on untouched skin under lamps that drifted; without height where `dome` is 0."""
    across, down = COLUMN - 160.0, ROW - 120.0
    fall = dome * np.exp(-(across**2 + down**2) / (2.0 * 20.0**2)) / 20.0
    slopes = np.stack([-across * fall, -down * fall], axis=-1)
    noise = NOISE * np.random.default_rng(seed).standard_normal((*SHAPE, 3))
    values = np.exp(slopes @ ANSWER + drift + noise).astype(np.float32)
    everywhere = np.ones(SHAPE, np.bool_)
    return NormalizedImage(values, everywhere, everywhere & clipped)
