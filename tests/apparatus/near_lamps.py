"""Frames of matt skin under three lamps whose places are known: what elevation does to them is physics."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter

from device.balls.sphere import Ball
from device.imaging.flat_field import NormalizedImage

SHAPE = (288, 384)
RADIUS_PX = 48.0
LAMPS_OUT_PX = 300.0


@dataclass(frozen=True)
class NearLamps:
    """Three lamps 120 degrees apart, `height_px` over the skin; `height_px` 0 for skin whose look never changes."""

    height_px: float
    vignetting: float = 0.0

    def light(self, z_px: np.ndarray, p: np.ndarray, q: np.ndarray, *, seen_at: float = 1.0) -> np.ndarray:
        """What a pixel sends back, shape (H, W, 3); `seen_at` 0 lights skin as if it were untouched."""
        row, column = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
        angle = np.radians([10.0, 130.0, 250.0])
        across = 0.5 * SHAPE[1] + LAMPS_OUT_PX * np.cos(angle) - column[..., None]
        down = 0.5 * SHAPE[0] + LAMPS_OUT_PX * np.sin(angle) - row[..., None]
        up = self.height_px - seen_at * z_px[..., None] * np.ones(3)
        facing = np.maximum(up - p[..., None] * across - q[..., None] * down, 0.0)
        far = ((column / SHAPE[1] - 0.5) ** 2 + (row / SHAPE[1] - 0.5) ** 2)[..., None]
        lit = facing / (across**2 + down**2 + up**2) ** 1.5 / np.sqrt(1.0 + p**2 + q**2)[..., None]
        return lit * 1e5 * (1.0 - self.vignetting * far)

    def flat_field(self) -> np.ndarray:
        """The reference's light, float32 array of shape (H, W, 3)."""
        flat = np.zeros(SHAPE)
        return self.light(flat, flat, flat).astype(np.float32)

    def intensity(
        self, z_px: np.ndarray, *, seen_at: float = 1.0, noise: float = 0.0, seed: int = 0
    ) -> NormalizedImage:
        """The intensity of a skin of this elevation."""
        q, p = np.gradient(z_px)
        values = self.light(z_px, p, q, seen_at=seen_at) / self.flat_field()
        values += noise * np.random.default_rng(seed).standard_normal(values.shape)
        return NormalizedImage(values.astype(np.float32), np.ones(SHAPE, bool), np.zeros(SHAPE, bool))


def press_px(ball: Ball, apex_px: float) -> np.ndarray:
    """Elevation of skin over a ball: the sphere inside its contact, an apron that falls off outside."""
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    distance = np.hypot(column - ball.column, row - ball.row)
    sphere = apex_px - ball.radius_px + np.sqrt(np.maximum(ball.radius_px**2 - distance**2, 0.0))
    rim = apex_px - ball.radius_px + np.sqrt(ball.radius_px**2 - ball.contact_radius_px**2)
    apron = rim * np.exp(-(distance - ball.contact_radius_px) / 12.0)
    return gaussian_filter(np.where(distance < ball.contact_radius_px, sphere, apron), 0.7)


def balls(count: int = 12, seed: int = 1) -> list[tuple[Ball, float]]:
    """Balls spread over the field, each with the elevation of its apex, pixels."""
    random = np.random.default_rng(seed)
    places = [(c, r) for r in (0.2, 0.5, 0.8) for c in (0.16, 0.39, 0.61, 0.84)][:count]
    return [
        (Ball(c * SHAPE[1] + random.uniform(-4, 4), r * SHAPE[0] + random.uniform(-4, 4), 28.0, RADIUS_PX), apex)
        for (c, r), apex in zip(places, random.uniform(13.0, 19.0, count), strict=True)
    ]
