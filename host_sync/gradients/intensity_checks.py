"""Refuses a frame that cannot be read, from a sample of its intensity: black or saturated."""

from __future__ import annotations

import numpy as np

from device.imaging.flat_field import DARK_FLOOR, EXPOSURE_STEP, NormalizedImage, check_exposed_sample
from device.surface.fields import Float32Array


def check_exposure(intensity: NormalizedImage, flat_field: Float32Array, name: str, coarseness: int = 1) -> None:
    """Refuse what `check_exposed` refuses, without the linear frame.

    flat_field : float32 array of shape (H, W, 3), what the frame was divided by
    coarseness : how many times fewer rows and columns are looked at

    Raises
    ------
    FrameError
        The frame is black or saturated; names `name`.
    """
    clipped_share = np.count_nonzero(intensity.clipped) / intensity.clipped.size
    step = coarseness * EXPOSURE_STEP
    light = intensity.values[::step, ::step] * np.maximum(flat_field[::step, ::step], np.float32(DARK_FLOOR))
    check_exposed_sample(light, clipped_share, name)
