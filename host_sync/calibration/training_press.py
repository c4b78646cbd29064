"""The presses of a calibration as it keeps them: without their frames, some with a small picture for the report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from device.balls.detector import RejectedBall
from device.balls.sphere import Ball
from device.surface.fields import Float32Array
from host_sync.calibration.balls import FittedBall, UsedPress

MAX_SHOWN: Final = 48
"""At most so many presses keep a picture."""

MAX_WIDTH_PX: Final = 1500
"""Width of all pictures of a row together."""


@dataclass(frozen=True, slots=True, eq=False)
class TrainingPress:
    """A press after calibration.

    shape : (H, W) of its frame
    balls, rejected, error, source, fitted : as in `UsedPress`
    picture : uint8 array of shape (h, w, 3), its intensity reduced, flat skin mid-grey; None where none is shown
    """

    name: str
    shape: tuple[int, int]
    balls: tuple[Ball, ...]
    rejected: tuple[RejectedBall, ...]
    error: str
    source: str
    fitted: tuple[FittedBall, ...]
    picture: NDArray[np.uint8] | None


def training_presses(presses: Sequence[UsedPress]) -> tuple[TrainingPress, ...]:
    """Return the presses with pictures of `MAX_SHOWN` of them at most."""
    shown = _chosen(presses)
    width_px = MAX_WIDTH_PX // pictures_across(len(shown))
    return tuple(
        TrainingPress(
            name=press.name,
            shape=press.intensity.shape,
            balls=press.balls,
            rejected=press.rejected,
            error=press.error,
            source=press.source,
            fitted=press.fitted,
            picture=_picture(press.intensity.values, width_px) if number in shown else None,
        )
        for number, press in enumerate(presses)
    )


def pictures_across(count: int) -> int:
    """Return pictures in a row of `count` in all."""
    return int(np.ceil(np.sqrt(count)))


def _chosen(presses: Sequence[UsedPress]) -> list[int]:
    """Return numbers of at most `MAX_SHOWN` presses: those with rejected balls first, the rest spread evenly."""
    rejected_ones = [i for i, press in enumerate(presses) if press.rejected or press.error][:MAX_SHOWN]
    clean = [i for i in range(len(presses)) if i not in rejected_ones]
    room = MAX_SHOWN - len(rejected_ones)
    spread = [clean[i * len(clean) // room] for i in range(room)] if len(clean) > room else clean
    return sorted(rejected_ones + spread)


def _picture(values: Float32Array, max_width_px: int) -> NDArray[np.uint8]:
    """Return the intensity as a picture: flat skin mid-grey, slightly compressed."""
    factor = max(1, values.shape[1] // max_width_px)
    if factor > 1:
        size = (values.shape[1] // factor, values.shape[0] // factor)
        values = np.asarray(cv2.resize(values, size, interpolation=cv2.INTER_AREA), np.float32)
    return np.asarray(np.rint(255.0 * np.clip(0.45 * np.nan_to_num(values), 0.0, 1.0) ** 0.8), np.uint8)
