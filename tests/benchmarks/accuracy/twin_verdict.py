"""New presses on the calibrated twin, evaluated: error of the surface, radius, masked pixels, coverage of ±σ."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from host_sync.calibration.calibrate import Method
from tests.benchmarks.accuracy.ball_error import BallError, judge_ball
from tests.benchmarks.accuracy.sigma_coverage import Coverage, height_coverage, slope_coverage, total
from tests.benchmarks.accuracy.twin_instrument import BALL_RADIUS_MM, TwinInstrument

PLACES: Final = ((0.5, 0.5), (0.25, 0.33), (0.7, 0.66), (0.36, 0.72), (0.76, 0.3))
"""Positions of balls, as fractions of the field: between those of the calibration's presses."""

OBJECTS: Final = ("coin", "texture", "step")
"""Other specimens, unlike balls, to test σ."""


@dataclass(frozen=True, slots=True, eq=False)
class TwinVerdict:
    """Results of new presses on one instrument."""

    balls: tuple[BallError, ...]
    heights: Coverage
    slopes: Coverage

    @property
    def surface_deg(self) -> float:
        """Mean error of the normal over all balls, degrees."""
        return float(np.concatenate([ball.surface_deg for ball in self.balls]).mean())

    @property
    def smooth_deg(self) -> float:
        """The same after smoothing, degrees."""
        return float(np.concatenate([ball.smooth_deg for ball in self.balls]).mean())

    @property
    def radius_off_by(self) -> float:
        """Relative difference of the median fitted radius to the true one."""
        return abs(float(np.median([ball.radius_ratio for ball in self.balls])) - 1.0)

    @property
    def masked_share(self) -> float:
        """Fraction of the pixels of the inner contacts that are invalid."""
        return float(np.mean([ball.masked_share for ball in self.balls]))


def judge_instrument(
    instrument: TwinInstrument,
    report_progress: Callable[[str], None],
    method: Method | None = None,
    places: Sequence[tuple[float, float]] = PLACES,
    objects: Sequence[str] = OBJECTS,
) -> TwinVerdict:
    """Results over a ball at each position, and the coverage over those and the named objects."""
    balls, heights, slopes = [], [], []
    pupil_mm = instrument.profile.pupil_height_mm
    camera_um = np.inf if pupil_mm is None else 1e3 * pupil_mm
    for press, what in [(instrument.press_ball, place) for place in places] + [
        (instrument.press_object, (name,)) for name in objects
    ]:
        scan = press(*what)
        report_progress(scan.name)
        found = instrument.reconstruct(scan, method)
        heights.append(height_coverage(found, scan.truth))
        slopes.append(slope_coverage(found, scan.truth))
        if press == instrument.press_ball:
            balls.append(judge_ball(found.height, scan.truth, BALL_RADIUS_MM * 1e3, camera_um))
    return TwinVerdict(tuple(balls), total(heights), total(slopes))
