"""Notices a frame whose colours are swapped: its untouched skin matches the reference only after a permutation."""

from __future__ import annotations

from itertools import permutations
from typing import Final

import numpy as np

from device.errors import CalibrationMismatch
from device.photometry import DARK_FLOOR, LinearFrame
from device.surface import Float32Array

CLEAR_FACTOR: Final = 0.5
"""A permutation must halve the disagreement with the reference before the frame is refused."""

CLEAR_DISAGREEMENT: Final = 0.06
"""Disagreement (median of |log intensity|) under which the order as given is never doubted."""


def check_channel_order(frame: LinearFrame, divisor: Float32Array, name: str) -> None:
    """Refuse a frame whose channels are in another order than its reference's.

    Raises
    ------
    CalibrationMismatch
        Names `name` and the order that the channels seem to have.
    """
    step = order_step(frame.shape)
    check_channel_order_sample(frame.rgb[::step, ::step], divisor[::step, ::step], name)


def order_step(shape: tuple[int, int]) -> int:
    """One pixel in so many rows and columns of a frame of shape (H, W) tells its channel order."""
    return max(1, shape[0] // 128)


def check_channel_order_sample(frame: Float32Array, divisor: Float32Array, name: str) -> None:
    """The same from a sample of a frame's linear light and its reference's, float32 arrays of shape (h, w, 3)."""
    light = np.log(np.maximum(frame, DARK_FLOOR))
    rest = np.log(np.maximum(divisor, DARK_FLOOR))
    as_given = _disagreement(light, rest)
    if as_given <= CLEAR_DISAGREEMENT:
        return
    disagreement = {order: _disagreement(light[..., order], rest) for order in permutations(range(3))}
    best = min(disagreement, key=lambda order: disagreement[order])
    if disagreement[best] < CLEAR_FACTOR * as_given:
        seen = ", ".join("RGB"[best.index(channel)] for channel in range(3))
        raise CalibrationMismatch(
            f"{name}: the channels are in the order {seen} where the reference has R, G, B: convert the file"
        )


def _disagreement(light: Float32Array, rest: Float32Array) -> float:
    """Median distance of log light from the reference's, mean over colours."""
    return float(np.median(np.abs(light - rest), axis=(0, 1)).mean())
