"""How much of each lamp's light arrives at the cells of a surface: rays to the points that stand for its strip."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from device.surface.fields import Float32Array, Float64Array, HeightMap, MaskArray, surface_slopes
from host_sync.kernels.parallel_rows import parallel_rows
from host_sync.lights.half_shadow_kernel import STRIDE, write_arriving
from host_sync.lights.lamp_model import POINT_SHARES, LampModel

WORK: Final = 200
"""Pixels of a field whose kernels take as long as the rays of one cell."""


@dataclass(frozen=True, slots=True, eq=False)
class ArrivingLight:
    """What arrives of lamps at the cells of a surface.

    What a cell's own plane keeps from it hides no light: that is left to the cosine law, so that a slope that is read
    too steep does not hide the light that would tell so.

    hidden : whether a lamp may be hidden, in part or turned away from, bool array of shape (h, w, 3)
    visible : how much arrives of each point of a lamp, past other skin, 0 to 1, float64 array (h, w, 3, points)
    facing : 0 where a lamp sets behind the cell's own plane, 1 where it stands over it by enough to count in full,
        float64 array of shape (h, w, 3)
    """

    hidden: MaskArray
    visible: Float64Array
    facing: Float64Array


def arriving_light(z_px: Float32Array, cell: int, model: LampModel) -> ArrivingLight:
    """The light of lamps over a surface. Skin outside the field hides nothing.

    z_px : elevation of cells of `cell` x `cell` pixels of the model's field, shape (h, w), at least (2, 2); finite
    """
    p, q = surface_slopes(HeightMap(z_px, float(cell)))
    places = model.points()[..., :3] * model.shape[1]
    size = (*z_px.shape, *places.shape[:2])
    hidden, visible, facing = np.empty(size[:3], np.bool_), np.empty(size), np.empty(size[:3])
    grid = float(cell), 0.5 * (cell - model.shape[1]), 0.5 * (cell - model.shape[0])
    skin = z_px, p, q, cv2.dilate(z_px, np.ones((2 * STRIDE + 3, 2 * STRIDE + 3), np.uint8))
    work = z_px.shape[0], WORK * z_px.shape[1]
    parallel_rows(write_arriving, work, *skin, places, np.array(POINT_SHARES), grid, hidden, visible, facing)
    return ArrivingLight(hidden, visible, facing)
