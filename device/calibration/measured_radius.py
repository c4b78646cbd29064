"""Radius of calibration balls as measured: a wrong ball has all its slopes wrong by one factor.

Two measurements share no assumption: the lights' shadows on the ball, which need their positions in the board profile,
and the inverse map of the last calibration of the same gel and lights, if there is one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from device.balls.sphere import BallSamples
from device.calibration.acceptance import Check
from device.inverse_map.model import InverseMap

GENTLE: Final = 0.5
"""Slopes up to which radii are read, as stated."""

MAX_OFF_BY_LAST: Final = 0.08
"""Largest relative difference of a ball's radius from the stated one, as the last calibration reads it."""

MAX_OFF_BY_SHADOW: Final = 0.1
"""The same by the lights' shadows: a light 1.5 mm from its place in the profile, 25 mm away, is worth 7 %."""

MIN_SHADOWS: Final = 4


@dataclass(frozen=True, slots=True)
class MeasuredRadii:
    """Measured radius of the balls over the stated one, medians; None: not measured."""

    stated_mm: float
    by_shadow: float | None
    by_last: float | None

    @property
    def checks(self) -> tuple[Check, ...]:
        """What is judged of the balls' radius."""
        found = []
        if self.by_shadow is not None:
            name = "ball radius off from the stated one by the lights' shadows, fraction"
            found.append(Check(name, abs(self.by_shadow - 1.0), MAX_OFF_BY_SHADOW, "at most"))
        if self.by_last is not None:
            name = "ball radius off from the stated one by the last calibration, fraction"
            found.append(Check(name, abs(self.by_last - 1.0), MAX_OFF_BY_LAST, "at most"))
        return tuple(found)

    @property
    def advice(self) -> str:
        """The measured radius and what to do, a sentence and a blank; empty if it agrees with the stated one."""
        if self.by_shadow is not None and abs(self.by_shadow - 1.0) > MAX_OFF_BY_SHADOW:
            return (
                f"By the lights' shadows on it the ball's radius is {self.by_shadow * self.stated_mm:.2f} mm, not "
                f"{self.stated_mm:g} mm: choose the right radius; if it is right, check pixel_pitch_um and the lights' "
                "position_mm in the board profile. "
            )
        if self.by_last is not None and abs(self.by_last - 1.0) > MAX_OFF_BY_LAST:
            return (
                f"By the last calibration the ball's radius is {self.by_last * self.stated_mm:.2f} mm, not "
                f"{self.stated_mm:g} mm: choose the right radius, or give the gel a new name if that one was wrong. "
            )
        return ""


def measure_radii(
    stated_mm: float, shadows_mm: Sequence[float], samples: BallSamples, last: InverseMap | None
) -> MeasuredRadii:
    """The radius of balls stated to have `stated_mm`, by their terminators (mm) and by the last calibration's map."""
    by_last = None
    if last is not None:
        shares = measured_radius_shares(samples, last)
        shares = shares[np.isfinite(shares)]
        by_last = float(np.median(shares)) if shares.size else None
    return MeasuredRadii(stated_mm, _by_shadow(stated_mm, shadows_mm), by_last)


def wrong_by_shadow(stated_mm: float, shadows_mm: Sequence[float]) -> str:
    """What is wrong with the balls by their shadows alone, which tell after a press or two; empty if nothing is."""
    return MeasuredRadii(stated_mm, _by_shadow(stated_mm, shadows_mm), None).advice


def measured_radius_shares(samples: BallSamples, last: InverseMap) -> np.ndarray:
    """Each ball's measured radius over the stated one, float64 array of shape (number of balls,), NaN without samples.

    last : the inverse map of the last calibration of the same gel and lights. A ball of radius R that is stated as R'
        shows about R' / R times the stated slopes.
    """
    stated = np.stack([samples.p, samples.q], axis=-1).astype(np.float64)
    gentle = np.linalg.norm(stated, axis=1) < GENTLE
    read = np.asarray(last.predict(samples.intensity[gentle], samples.column[gentle], samples.row[gentle]))[:, :2]
    stated, ball = stated[gentle], samples.ball[gentle]
    count = int(samples.ball.max()) + 1
    both = np.bincount(ball, (stated * read).sum(axis=1), count)
    alone = np.bincount(ball, (stated * stated).sum(axis=1), count)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(alone / both)


def _by_shadow(stated_mm: float, shadows_mm: Sequence[float]) -> float | None:
    return float(np.median(shadows_mm)) / stated_mm if len(shadows_mm) >= MIN_SHADOWS else None
