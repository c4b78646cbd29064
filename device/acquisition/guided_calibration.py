"""The guided calibration as a state machine: it asks for presses, receives frames, and ends passed or failed.

It touches no hardware: command line, screens and headless mode take the frames and share it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np

from device.balls.detector import RejectedBall, find_balls
from device.balls.sphere import Ball, BallSamples, gather_samples
from device.calibration.acceptance import MIN_BALLS, Check, Coverage, check_fit, fit_checks, measure_coverage
from device.calibration.fit import InverseFit, fit_inverse_map
from device.calibration.measured_radius import MeasuredRadii, measure_radii, shadow_radii_mm, wrong_by_shadow
from device.errors import CalibrationError
from device.imaging.flat_field import LinearFrame, bin_bayer, check_exposed, flat_field_correct, make_flat_field
from device.imaging.frame_light import Brightness
from device.inverse_map.model import InverseMap
from device.quality.untouched import MAX_CHANGED, changed_shape, reference_fault
from device.surface import Float32Array
from hal.board_profile import BoardProfile
from hal.frame import RawFrame
from hal.interfaces import LiftOff, OperatorRequest, PressBall

COLUMNS: Final = 4
ROWS: Final = 3
MAX_TRIES: Final = 3
MAX_EXTRA: Final = 4
"""Maximum number of presses beyond the planned ones, for parts of the field that are still uncovered."""

MAX_FIT_SAMPLES: Final = 15_000

Phase = Literal["reference", "press", "fitting", "passed", "failed"]


BINNING: Final = 2
"""Balls are detected and the map is fitted at half size: four times faster, with half the noise."""


@dataclass(frozen=True, slots=True)
class CalibrationProgress:
    """State of a guided calibration.

    instruction : what to do now, one sentence
    complaint : what was wrong with the last frame, or an empty text
    place : where to press next, as fractions of the field's columns and rows; None if nothing is to be pressed
    accepted, wanted : presses with a ball so far, and presses planned
    circles, rejected : found in the last press, in sensor pixels
    coverage : of field and slopes so far; None before the first ball
    next_presses : what is still uncovered, one sentence each
    checks : the acceptance checks, after the fit
    calibration_id, brightness : of the published calibration, if passed
    """

    phase: Phase
    instruction: str
    complaint: str = ""
    place: tuple[float, float] | None = None
    accepted: int = 0
    wanted: int = COLUMNS * ROWS
    circles: tuple[Ball, ...] = ()
    rejected: tuple[RejectedBall, ...] = ()
    coverage: Coverage | None = None
    next_presses: tuple[str, ...] = ()
    checks: tuple[Check, ...] = ()
    calibration_id: str | None = None
    brightness: Brightness | None = None

    @property
    def is_over(self) -> bool:
        """True if it has passed or failed."""
        return self.phase in {"passed", "failed"}


def press_places() -> list[tuple[float, float]]:
    """Return where to press the ball: fractions of the field's columns and rows, row by row."""
    return [((column + 0.5) / COLUMNS, (row + 0.5) / ROWS) for row in range(ROWS) for column in range(COLUMNS)]


@dataclass(frozen=True, slots=True, eq=False)
class LastCalibration:
    """Reference and inverse map of the last calibration of this gel and lights, for comparison with a new one."""

    reference: RawFrame
    inverse_map: InverseMap


class GuidedCalibration:
    """One calibration from the reference to the fit.

    Parameters
    ----------
    profile : of the board that takes the frames
    ball_radius_mm : radius of the calibration ball
    last : the calibration of the same gel and lights that is active now; None: there is none to compare with
    """

    def __init__(self, profile: BoardProfile, ball_radius_mm: float, last: LastCalibration | None = None) -> None:
        self.ball_radius_mm = ball_radius_mm
        self._last = last
        self._is_warned = False
        self._reference: RawFrame | None = None
        self.presses: list[AcceptedPress] = []
        self._profile = profile
        self._flat_field: Float32Array | None = None
        self._places = press_places()
        self._extra = 0
        self._tries = 0
        self.progress = CalibrationProgress("reference", "Touch nothing with the gel, then push the button.")

    @property
    def request(self) -> OperatorRequest:
        """Return what the operator should do now."""
        place = self.progress.place
        return LiftOff() if place is None else PressBall(self.ball_radius_mm, *place)

    @property
    def reference(self) -> RawFrame:
        """The frame of untouched skin.

        Raises
        ------
        CalibrationError
            It was not taken yet.
        """
        if self._reference is None:
            raise CalibrationError("no reference yet: touch nothing with the gel and push the button")
        return self._reference

    def add_frame(self, frame: RawFrame) -> None:
        """Use the requested frame; `progress` then says what comes next.

        Raises
        ------
        FrameError
            The reference is black or saturated: take it again.
        """
        if self.progress.phase == "reference":
            self._add_reference(frame)
        elif self.progress.phase == "press":
            self._add_press(frame)

    def fit(self) -> InverseFit:
        """Return the inverse map fitted to the presses; `progress` holds the acceptance checks.

        Raises
        ------
        CalibrationError
            Too few balls, or they contradict each other, or it has failed before; `progress` has failed.
        """
        if self.progress.phase == "failed":
            raise CalibrationError(self.progress.instruction)
        try:
            fit = self._fit()
        except CalibrationError as error:
            self.fail(str(error))
            raise
        rejected = int((~fit.kept).sum()) + sum(len(press.rejected) for press in self.presses)
        coverage = self.progress.coverage
        checks = fit_checks(int(fit.kept.sum()), rejected, fit.held_out_deg, coverage) if coverage else ()
        radii = self._measured_radii()
        self.progress = replace(self.progress, checks=(*checks, *radii.checks))
        if failed := [check.name for check in self.progress.checks if not check.passed]:
            sentence = f"Calibration failed in: {', '.join(failed)}. {radii.advice}The previous one stays active."
            self.fail(sentence)
            raise CalibrationError(sentence)
        return fit

    def succeed(self, calibration_id: str, brightness: Brightness | None) -> None:
        """End as passed: the calibration was published under this id and is active."""
        self.progress = replace(
            self.progress,
            phase="passed",
            instruction="Calibration passed and is active.",
            calibration_id=calibration_id,
            brightness=brightness,
        )

    def fail(self, sentence: str) -> None:
        """End as failed; the previous calibration stays active."""
        self.progress = replace(self.progress, phase="failed", instruction=sentence, place=None)

    def _add_reference(self, frame: RawFrame) -> None:
        binned = bin_bayer(frame, BINNING)
        check_exposed(binned, "the reference")
        if complaint := reference_fault(binned) or self._changed_since(binned):
            instruction = "Again: touch nothing with the gel, then push the button."
            self.progress = replace(self.progress, complaint=complaint, instruction=instruction)
            return
        self._reference, self._flat_field = frame, make_flat_field(binned)
        self.progress = replace(self.progress, complaint="")
        self._ask_next()

    def _changed_since(self, reference: LinearFrame) -> str:
        """Return a doubt about a reference whose light differs from the last one's, else an empty text.

        It is stated once, since skin and lights may change.
        """
        if self._last is None or self._last.reference.shape != self._frame_shape(reference) or self._is_warned:
            return ""
        changed = changed_shape(reference, bin_bayer(self._last.reference, BINNING))
        self._is_warned = changed > MAX_CHANGED
        if not self._is_warned:
            return ""
        return (
            f"the skin's light differs by {changed:.1%} from the last reference's: is nothing on the gel, is it clean? "
            "Push again if so"
        )

    @staticmethod
    def _frame_shape(binned: LinearFrame) -> tuple[int, int]:
        return BINNING * binned.shape[0], BINNING * binned.shape[1]

    def _measured_radii(self) -> MeasuredRadii:
        """Return the balls' radius as far as it can be measured by now."""
        by_last = None
        if self._last is not None and self._last.reference.shape == self.reference.shape:
            by_last = self._last.inverse_map
        shadows = [radius for press in self.presses for radius in press.shadow_radii_mm]
        return measure_radii(self.ball_radius_mm, shadows, joined_samples(self.presses), by_last)

    def _add_press(self, frame: RawFrame) -> None:
        if self._flat_field is None:
            raise CalibrationError("a press came before the reference: start the calibration again")
        read = read_press(frame, self._flat_field, self.ball_radius_mm, self._profile)
        self.progress = replace(self.progress, circles=read.circles, rejected=read.rejected, complaint=read.complaint)
        self._tries += 1
        if read.press is None and self._tries < MAX_TRIES:
            instruction = self.progress.instruction.removeprefix("Again: ")
            self.progress = replace(self.progress, instruction=f"Again: {instruction}")
            return
        if read.press is not None:
            self.presses.append(read.press)
            if wrong := wrong_by_shadow(
                self.ball_radius_mm, [radius for press in self.presses for radius in press.shadow_radii_mm]
            ):
                self.fail(f"{wrong}The previous calibration stays active.")
                return
        self._places.pop(0)
        self._ask_next()

    def _ask_next(self) -> None:
        """Ask for the next planned place, then for uncovered parts of the field, then start the fit."""
        self._tries = 0
        coverage = self._coverage()
        if not self._places and coverage and self._extra < MAX_EXTRA and (place := coverage.next_place()):
            self._extra += 1
            self._places.append(place)
        wanted = len(press_places()) + self._extra
        now = replace(
            self.progress,
            accepted=len(self.presses),
            wanted=wanted,
            coverage=coverage,
            next_presses=coverage.next_presses() if coverage else (),
        )
        if not self._places:
            self.progress = replace(now, phase="fitting", instruction="Fitting the model ...", place=None)
            return
        number = wanted - len(self._places) + 1
        place = self._places[0]
        asked = f"{number}/{wanted}: press the ball {describe_place(*place)}, then push the button."
        self.progress = replace(now, phase="press", instruction=asked, place=place)

    def _coverage(self) -> Coverage | None:
        if not self.presses:
            return None
        steepest = max(ball.steepest for press in self.presses for ball in press.balls)
        return measure_coverage(joined_samples(self.presses), self.reference.shape, steepest)

    def _fit(self) -> InverseFit:
        balls = [ball for press in self.presses for ball in press.balls]
        if len(balls) < MIN_BALLS:
            raise CalibrationError(
                f"only {len(balls)} of {self.progress.wanted} presses showed a usable ball, {MIN_BALLS} are needed: "
                "press deeper, wipe ball and gel, and calibrate again"
            )
        fit = fit_inverse_map(joined_samples(self.presses), balls, self.reference.shape, max_samples=MAX_FIT_SAMPLES)
        check_fit(fit)
        return fit


def describe_place(column_fraction: float, row_fraction: float) -> str:
    """Return a place of the field in words."""
    across = ("far left", "left", "right", "far right")[min(int(column_fraction * COLUMNS), COLUMNS - 1)]
    down = ("at the top", "half-way down", "at the bottom")[min(int(row_fraction * ROWS), ROWS - 1)]
    return f"{across}, {down}"


@dataclass(frozen=True, slots=True, eq=False)
class AcceptedPress:
    """A press with at least one ball.

    balls : in full-size pixels
    rejected : in full-size pixels, with the reason
    samples : of the pixels inside the balls, at full-size coordinates
    shadow_radii_mm : radius of the balls by each terminator that was seen
    """

    frame: RawFrame
    balls: tuple[Ball, ...]
    rejected: tuple[RejectedBall, ...]
    samples: BallSamples
    shadow_radii_mm: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class PressReading:
    """One press: its training samples (None: no ball), circles in sensor pixels, and what is wrong with it."""

    press: AcceptedPress | None
    circles: tuple[Ball, ...]
    rejected: tuple[RejectedBall, ...]
    complaint: str


def read_press(frame: RawFrame, flat_field: Float32Array, radius_mm: float, profile: BoardProfile) -> PressReading:
    """Detect balls of a stated radius in a frame of the profile's board; `flat_field` is at half size."""
    intensity = flat_field_correct(bin_bayer(frame, BINNING), flat_field)
    pitch_mm = BINNING * 1e-3 * profile.sensor.pixel_pitch_um
    search = find_balls(intensity, radius_mm / pitch_mm)
    balls = tuple(ball.enlarged(BINNING) for ball in search.found)
    rejected = tuple(replace(ball, column=BINNING * ball.column, row=BINNING * ball.row) for ball in search.rejected)
    if not search.found:
        reasons = "; ".join(sorted({ball.reason for ball in search.rejected}))
        complaint = f"no usable ball found ({reasons})" if reasons else "no ball found"
        return PressReading(None, (), rejected, complaint)
    samples = gather_samples([(intensity, search.found)], for_fit=True).enlarged(BINNING)
    shadows = shadow_radii_mm(intensity, search.found, [light.position_mm for light in profile.lights], pitch_mm)
    return PressReading(AcceptedPress(frame, balls, rejected, samples, shadows), balls, rejected, "")


def joined_samples(presses: Sequence[AcceptedPress]) -> BallSamples:
    """Return the samples of all presses, with balls numbered consecutively."""
    first = np.cumsum([0] + [len(press.balls) for press in presses])
    samples = [press.samples for press in presses]
    return BallSamples(
        intensity=np.concatenate([part.intensity for part in samples]),
        p=np.concatenate([part.p for part in samples]),
        q=np.concatenate([part.q for part in samples]),
        column=np.concatenate([part.column for part in samples]),
        row=np.concatenate([part.row for part in samples]),
        ball=np.concatenate([part.ball + offset for part, offset in zip(samples, first[:-1], strict=True)]),
        quiet=np.concatenate([part.training_intensity for part in samples]),
    )
