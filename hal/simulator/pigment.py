"""The pigment of the twin's skin: a coat is never quite even, and what is fixed to the skin multiplies its light."""

from __future__ import annotations

import cv2
import numpy as np

from hal.simulator.arrays import Float32Array

SPOT_PX = 2.0
"""Standard deviation of the spots, pixels; as much of the contrast is grain of single pixels."""


def pigment_pattern(shape: tuple[int, int], contrast: float, seed: int) -> Float32Array:
    """Reflectance of the coat over its mean: float32 array of `shape` (H, W), its standard deviation `contrast`."""
    if contrast == 0.0:
        return np.ones(shape, np.float32)
    random = np.random.Generator(np.random.SFC64([seed, 0x5C]))
    grain = random.standard_normal(shape, dtype=np.float32)
    spots = cv2.GaussianBlur(random.standard_normal(shape, dtype=np.float32), (0, 0), SPOT_PX)
    mixed = (grain + spots / np.float32(spots.std())) / np.float32(np.sqrt(2.0))
    return np.asarray(np.maximum(np.float32(1.0) + np.float32(contrast) * mixed, np.float32(0.05)), np.float32)
