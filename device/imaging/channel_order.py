"""Detects swapped colour channels and turned frames: untouched skin matches the reference only after a permutation."""

from __future__ import annotations

from itertools import permutations
from typing import Final

import numpy as np

from device.errors import CalibrationMismatch
from device.imaging.flat_field import DARK_FLOOR, LinearFrame
from device.surface.fields import Float32Array

CLEAR_FACTOR: Final = 0.5
"""A permutation must reduce the disagreement to this fraction before the frame is refused."""

_VIEWS: Final[dict[str, tuple[slice, ...]]] = {
    "mirrored left to right": np.s_[:, ::-1],
    "mirrored top to bottom": np.s_[::-1, :],
    "turned by half a turn": np.s_[::-1, ::-1],
}

ROWS_SAMPLED: Final = 128
"""About as many rows, and columns at the same stride, are tested."""

CLEAR_DISAGREEMENT: Final = 0.06
"""Disagreement (median of |log intensity|) below which the given order is accepted without a test."""


def check_channel_order(frame: LinearFrame, flat_field: Float32Array, name: str) -> None:
    """Refuse a frame whose channels are in another order than its reference's, or that is mirrored or turned.

    Raises
    ------
    CalibrationMismatch
        Names the frame and the order that its channels seem to have, or how it is turned.
    """
    step = max(1, frame.shape[0] // ROWS_SAMPLED)
    light = np.log(np.maximum(frame.rgb[::step, ::step], DARK_FLOOR))
    rest = np.log(np.maximum(flat_field[::step, ::step], DARK_FLOOR))
    as_given = _disagreement(light, rest)
    if as_given <= CLEAR_DISAGREEMENT:
        return
    disagreement = {order: _disagreement(light[..., order], rest) for order in permutations(range(3))}
    best = min(disagreement, key=lambda order: disagreement[order])
    turned = {words: _disagreement(light[view], rest) for words, view in _VIEWS.items()}
    view = min(turned, key=lambda words: turned[words])
    if turned[view] < min(CLEAR_FACTOR * as_given, disagreement[best]):
        raise CalibrationMismatch(
            f"{name}: is {view} against the untouched skin: take all frames as one camera mode does"
        )
    if disagreement[best] < CLEAR_FACTOR * as_given:
        seen = ", ".join("RGB"[best.index(channel)] for channel in range(3))
        raise CalibrationMismatch(f"{name}: the channels are in the order {seen}, not R, G, B: convert the file")


def _disagreement(light: Float32Array, rest: Float32Array) -> float:
    """Return the median distance of log light from the reference's, averaged over colours."""
    return float(np.median(np.abs(light - rest), axis=(0, 1)).mean())
