"""Frames of matt skin under any number of lights around it, each of another strength."""

from __future__ import annotations

import numpy as np

from device.imaging.flat_field import SATURATED, LinearFrame


def lit_by_ring(z_px: np.ndarray, lights: int, seed: int, *, noise: float = 0.004) -> LinearFrame:
    """The frame of skin of this elevation (pixels, shape (H, W)); noise as of an 8 bit camera."""
    q, p = np.gradient(z_px)
    row, column = np.mgrid[: z_px.shape[0], : z_px.shape[1]] / z_px.shape[1] - 0.5
    planes = []
    for number in range(lights):
        angle = 2.0 * np.pi * number / lights + 0.3
        across = 0.7 * np.cos(angle) - 0.25 * column
        down = 0.7 * np.sin(angle) - 0.25 * row
        strength = 0.4 * (1.0 + 0.1 * np.cos(2.0 * angle)) * (1.0 + 0.3 * (across * column + down * row))
        planes.append(strength * np.maximum(1.0 - across * p - down * q, 0.0) / np.sqrt(1.0 + p * p + q * q))
    light = np.stack(planes, axis=-1) + noise * np.random.default_rng(seed).standard_normal((*z_px.shape, lights))
    rgb = np.clip(light, 0.0, 1.0).astype(np.float32)
    return LinearFrame(rgb, np.any(rgb >= SATURATED, axis=-1))
