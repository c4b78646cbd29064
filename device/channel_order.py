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
    step = max(1, frame.shape[0] // 128)
    light = np.log(np.maximum(frame.rgb[::step, ::step], DARK_FLOOR))
    rest = np.log(np.maximum(divisor[::step, ::step], DARK_FLOOR))
    disagreement = {
        order: float(np.median(np.abs(light[..., order] - rest), axis=(0, 1)).mean())
        for order in permutations(range(3))
    }
    as_given = disagreement[0, 1, 2]
    best = min(disagreement, key=lambda order: disagreement[order])
    if as_given > CLEAR_DISAGREEMENT and disagreement[best] < CLEAR_FACTOR * as_given:
        seen = ", ".join("RGB"[best.index(channel)] for channel in range(3))
        raise CalibrationMismatch(
            f"{name}: the channels are in the order {seen} where the reference has R, G, B: convert the file"
        )
