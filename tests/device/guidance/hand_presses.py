"""Touches of one object by hand, as quick looks: the twin's skin over a random relief, with level, bow and noise."""

from __future__ import annotations

import cv2
import numpy as np

from device.surface import HeightMap
from hal.simulator.elastomer import drape

PITCH_MM = 0.1
ROWS, COLUMNS = 130, 175
SLAB_MM = 3.0
OBJECT_MM = 80.0


class Relief:
    """A random object 80 mm wide: pits and bumps of about 0.3 to 1 mm, some tens of µm high."""

    def __init__(self, seed: int) -> None:
        random = np.random.default_rng(seed)
        size = round(OBJECT_MM / PITCH_MM)
        self.height_mm = np.zeros((size, size), np.float32)
        for sigma_mm in random.uniform(0.25, 0.9, 2):
            wave = cv2.GaussianBlur(random.normal(size=(size, size)).astype(np.float32), (0, 0), sigma_mm / PITCH_MM)
            self.height_mm += np.float32(random.uniform(0.02, 0.06)) * wave / wave.std()

    def touch(self, place_mm: tuple[float, float], turn_deg: float, seed: int) -> HeightMap:
        """The quick look with the instrument's middle at (right, down) mm of the object's, turned clockwise."""
        random = np.random.default_rng([seed, 7])
        cosine, sine = (float(value) for value in (np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))))
        right, down = np.meshgrid(np.arange(COLUMNS) - (COLUMNS - 1) / 2, np.arange(ROWS) - (ROWS - 1) / 2)
        x = cosine * right - sine * down + place_mm[0] / PITCH_MM + 0.5 * OBJECT_MM / PITCH_MM
        y = sine * right + cosine * down + place_mm[1] / PITCH_MM + 0.5 * OBJECT_MM / PITCH_MM
        seen = cv2.remap(self.height_mm, x.astype(np.float32), y.astype(np.float32), cv2.INTER_LINEAR)
        lean = random.normal(0.0, 0.004, 2)
        depth_mm = random.uniform(0.15, 0.4)
        obstacle = seen + PITCH_MM * (lean[0] * right + lean[1] * down) + depth_mm
        skin = drape(obstacle, PITCH_MM, SLAB_MM, cycles=2).height_mm
        bow = random.normal(0.0, 20.0) * ((right / COLUMNS) ** 2 + (down / ROWS) ** 2)
        z_um = 1e3 * skin + bow + random.normal(0.0, 2.0, skin.shape)
        return HeightMap(np.asarray(z_um, np.float32), 1e3 * PITCH_MM)
