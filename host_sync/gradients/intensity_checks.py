"""Refuses a frame that cannot be read, from a sample of its intensity: black, saturated, or with swapped colours."""

from __future__ import annotations

import numpy as np

from device.imaging.channel_order import check_channel_order_sample, order_step
from device.imaging.flat_field import DARK_FLOOR, EXPOSURE_STEP, NormalizedImage, check_exposed_sample
from device.surface.fields import Float32Array


def check_intensity(intensity: NormalizedImage, flat_field: Float32Array, name: str, coarseness: int = 1) -> None:
    """Refuse what `check_exposed` and `check_channel_order` refuse, without the linear frame.

    flat_field : float32 array of shape (H, W, 3), what the frame was divided by
    coarseness : how many times fewer rows and columns are looked at

    Raises
    ------
    FrameError
        The frame is black or saturated; names `name`.
    CalibrationMismatch
        Its channels are in another order than the reference's.
    """
    check_exposure(intensity, flat_field, name, coarseness)
    check_channel_order_sample(*_sample(intensity, flat_field, coarseness * order_step(intensity.shape)), name)


def check_exposure(intensity: NormalizedImage, flat_field: Float32Array, name: str, coarseness: int = 1) -> None:
    """Refuse what `check_exposed` refuses; arguments as for `check_intensity`.

    Raises
    ------
    FrameError
        The frame is black or saturated; names `name`.
    """
    clipped_share = np.count_nonzero(intensity.clipped) / intensity.clipped.size
    light, _ = _sample(intensity, flat_field, coarseness * EXPOSURE_STEP)
    check_exposed_sample(light, clipped_share, name)


def _sample(intensity: NormalizedImage, flat_field: Float32Array, step: int) -> tuple[Float32Array, Float32Array]:
    """Linear light and divisor of every `step`-th row and column."""
    rest = flat_field[::step, ::step]
    return intensity.values[::step, ::step] * np.maximum(rest, np.float32(DARK_FLOOR)), rest
