"""What a frame of a calibration press shows: its balls, in sensor pixels, and the samples that they teach."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from device.ball import Ball, BallSamples, gather_samples
from device.ball_finder import RejectedBall, find_balls
from device.photometry import bin_bayer, divide
from device.scanning.calibration_files import AcceptedPress
from device.surface import Float32Array
from hal.frame import RawFrame

BINNING: Final = 2
"""Balls are sought and the map is fitted at half size: four times as fast, and with half the noise."""


@dataclass(frozen=True, slots=True, eq=False)
class PressReading:
    """One press: what it teaches (None: nothing), its circles in sensor pixels, and what is wrong with it."""

    press: AcceptedPress | None
    circles: tuple[Ball, ...]
    rejected: tuple[RejectedBall, ...]
    complaint: str


def read_press(frame: RawFrame, divisor: Float32Array, radius_px: float) -> PressReading:
    """The reading of a frame; `divisor` is the reference's at half size, `radius_px` the ball's in sensor pixels."""
    intensity = divide(bin_bayer(frame, BINNING), divisor)
    search = find_balls(intensity, radius_px / BINNING)
    balls = tuple(ball.enlarged(BINNING) for ball in search.found)
    rejected = tuple(replace(ball, column=BINNING * ball.column, row=BINNING * ball.row) for ball in search.rejected)
    if not search.found:
        reasons = "; ".join(sorted({ball.reason for ball in search.rejected}))
        complaint = f"no usable ball is seen ({reasons})" if reasons else "no ball is seen"
        return PressReading(None, (), rejected, complaint)
    samples = gather_samples([(intensity, search.found)]).enlarged(BINNING)
    return PressReading(AcceptedPress(frame, balls, rejected, samples), balls, rejected, "")


def joined_samples(presses: Sequence[AcceptedPress]) -> BallSamples:
    """The samples of all presses, balls numbered through."""
    first = np.cumsum([0] + [len(press.balls) for press in presses])
    samples = [press.samples for press in presses]
    return BallSamples(
        intensity=np.concatenate([part.intensity for part in samples]),
        p=np.concatenate([part.p for part in samples]),
        q=np.concatenate([part.q for part in samples]),
        column=np.concatenate([part.column for part in samples]),
        row=np.concatenate([part.row for part in samples]),
        ball=np.concatenate([part.ball + offset for part, offset in zip(samples, first[:-1], strict=True)]),
    )
