"""The twin's sensor: Bayer filters, charge, noise, saturation, counts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hal.board_profile import SensorFacts
from hal.twin.arrays import Float32Array


def mosaic_weights(sensor: SensorFacts, passed: tuple[float, float, float]) -> Float32Array:
    """Share of one light that each pixel's filter passes, float32 array of shape (H, W), from `passed` by R, G, B."""
    cell = np.array([passed["RGB".index(letter)] for letter in sensor.bayer_order], np.float32).reshape(2, 2)
    return np.tile(cell, (sensor.rows // 2, sensor.columns // 2))


def expose(
    charge_e: Float32Array, sensor: SensorFacts, analogue_gain: float, random: np.random.Generator
) -> NDArray[np.uint16]:
    """Counts (dn), uint16 array of shape (H, W), of the expected charge (e⁻) that each pixel collects.

    Shot noise is taken as normal: at ten electrons and more nobody can tell, and under that the read noise rules.
    """
    noise = random.standard_normal(charge_e.shape, dtype=np.float32)
    noise *= np.sqrt(charge_e + np.float32(sensor.read_noise_e**2))
    collected = np.minimum(charge_e + noise, np.float32(sensor.full_well_e))
    dn_per_e = analogue_gain * (sensor.white_level_dn - sensor.black_level_dn) / sensor.full_well_e
    counts = collected * np.float32(dn_per_e) + np.float32(sensor.black_level_dn)
    return np.asarray(np.clip(np.rint(counts), 0.0, sensor.white_level_dn), np.uint16)
