"""The guided calibration as a state machine: it says what to press next, is handed frames, and ends passed or failed.

It touches no hardware: who drives it takes the frames, so that command line, screen and headless mode share it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, Literal

from device.ball import Ball
from device.ball_finder import RejectedBall
from device.calibration_checks import Check, check_fit, fit_checks
from device.calibration_coverage import Coverage, measure_coverage
from device.calibration_limits import FEWEST_BALLS
from device.errors import CalibrationError
from device.exposure_levels import Brightness
from device.inverse_fit import InverseFit, fit_inverse_map
from device.photometry import bin_bayer, blurred_reference, check_exposed
from device.scanning.calibration_files import AcceptedPress
from device.scanning.press_reading import BINNING, joined_samples, read_press
from device.surface import Float32Array
from hal.board_profile import BoardProfile
from hal.frame import RawFrame
from hal.interfaces import LiftOff, OperatorRequest, PressBall

COLUMNS: Final = 4
ROWS: Final = 3
MOST_TRIES: Final = 3
MOST_EXTRA: Final = 4
"""Presses beyond the planned ones, where a sector of the field is still uncovered."""

FITTED_SAMPLES: Final = 15_000

Phase = Literal["reference", "press", "fitting", "passed", "failed"]


@dataclass(frozen=True, slots=True)
class CalibrationProgress:
    """Where a guided calibration stands.

    instruction : what to do now, one sentence
    complaint : what was wrong with the last frame, or an empty text
    place : where to press next, as shares of the field's columns and rows; None when nothing is to be pressed
    accepted, wanted : presses that teach, and how many are planned
    circles, rejected : what the last press showed, in sensor pixels
    coverage : of field and slopes so far; None before the first ball
    next_presses : what is still uncovered, one sentence each
    checks : the numbers that decide, once fitted
    calibration_id, brightness : of the published calibration, once passed
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
        """Whether it has passed or failed."""
        return self.phase in {"passed", "failed"}


def press_places() -> list[tuple[float, float]]:
    """Where the ball is to be pressed: shares of the field's columns and rows, row by row."""
    return [((column + 0.5) / COLUMNS, (row + 0.5) / ROWS) for row in range(ROWS) for column in range(COLUMNS)]


class GuidedCalibration:
    """One calibration from the reference to the fit.

    Parameters
    ----------
    profile : board whose frames will come
    ball_radius_mm : of the ball that is pressed
    """

    def __init__(self, profile: BoardProfile, ball_radius_mm: float) -> None:
        self.ball_radius_mm = ball_radius_mm
        self._reference: RawFrame | None = None
        self.presses: list[AcceptedPress] = []
        self._radius_px = ball_radius_mm * 1e3 / profile.sensor.pixel_pitch_um
        self._divisor: Float32Array | None = None
        self._places = press_places()
        self._extra = 0
        self._tries = 0
        self.progress = CalibrationProgress("reference", "Touch nothing with the gel, then push the button.")

    @property
    def request(self) -> OperatorRequest:
        """What the operator is to do now."""
        place = self.progress.place
        return LiftOff() if place is None else PressBall(self.ball_radius_mm, *place)

    @property
    def reference(self) -> RawFrame:
        """The frame of the skin at rest.

        Raises
        ------
        CalibrationError
            It was not taken yet.
        """
        if self._reference is None:
            raise CalibrationError("there is no reference yet: touch nothing with the gel and push the button")
        return self._reference

    def take(self, frame: RawFrame) -> None:
        """Read the frame that was asked for; `progress` then says how to go on.

        Raises
        ------
        FrameError
            The reference is black or saturated: take it again.
        """
        if self.progress.phase == "reference":
            self._take_reference(frame)
        elif self.progress.phase == "press":
            self._take_press(frame)

    def fit(self) -> InverseFit:
        """The inverse map that the presses teach; `progress` holds the checks.

        Raises
        ------
        CalibrationError
            Too few balls, or they contradict each other; `progress` has failed.
        """
        try:
            fit = self._fit()
        except CalibrationError as error:
            self.fail(str(error))
            raise
        rejected = int((~fit.kept).sum()) + sum(len(press.rejected) for press in self.presses)
        coverage = self.progress.coverage
        checks = fit_checks(int(fit.kept.sum()), rejected, fit.held_out_deg, coverage) if coverage else ()
        self.progress = replace(self.progress, checks=checks)
        return fit

    def succeed(self, calibration_id: str, brightness: Brightness | None) -> None:
        """The calibration was published under that id, and uses so much of the sensor's range."""
        weak = [check.name for check in self.progress.checks if not check.passed]
        doubt = f" Weak in: {', '.join(weak)}." if weak else ""
        self.progress = replace(
            self.progress,
            phase="passed",
            instruction=f"Calibration passed and is in force.{doubt}",
            calibration_id=calibration_id,
            brightness=brightness,
        )

    def fail(self, sentence: str) -> None:
        """It ends here; the calibration before stays in force."""
        self.progress = replace(self.progress, phase="failed", instruction=sentence, place=None)

    def _take_reference(self, frame: RawFrame) -> None:
        binned = bin_bayer(frame, BINNING)
        check_exposed(binned, "the reference")
        self._reference, self._divisor = frame, blurred_reference(binned)
        self._ask_next()

    def _take_press(self, frame: RawFrame) -> None:
        if self._divisor is None:
            raise CalibrationError("a press came before the reference: start the calibration again")
        read = read_press(frame, self._divisor, self._radius_px)
        self.progress = replace(self.progress, circles=read.circles, rejected=read.rejected, complaint=read.complaint)
        self._tries += 1
        if read.press is None and self._tries < MOST_TRIES:
            again = self.progress.instruction.removeprefix("Once more: ")
            self.progress = replace(self.progress, instruction=f"Once more: {again}")
            return
        if read.press is not None:
            self.presses.append(read.press)
        self._places.pop(0)
        self._ask_next()

    def _ask_next(self) -> None:
        """Ask for the next place: the planned ones, then sectors that are still uncovered, then none."""
        self._tries = 0
        coverage = self._coverage()
        if not self._places and coverage and self._extra < MOST_EXTRA and (place := coverage.next_place()):
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
        asked = f"{number}/{wanted}: press the ball {where(*place)}, then push the button."
        self.progress = replace(now, phase="press", instruction=asked, place=place)

    def _coverage(self) -> Coverage | None:
        if not self.presses:
            return None
        steepest = max(ball.steepest for press in self.presses for ball in press.balls)
        return measure_coverage(joined_samples(self.presses), self.reference.shape, steepest)

    def _fit(self) -> InverseFit:
        balls = [ball for press in self.presses for ball in press.balls]
        if len(balls) < FEWEST_BALLS:
            raise CalibrationError(
                f"only {len(balls)} of {self.progress.wanted} presses showed a usable ball and {FEWEST_BALLS} are "
                "needed: press deeper, wipe ball and gel, and calibrate again"
            )
        fit = fit_inverse_map(joined_samples(self.presses), balls, self.reference.shape, max_samples=FITTED_SAMPLES)
        check_fit(fit)
        return fit


def where(column_share: float, row_share: float) -> str:
    """A place of the field in words."""
    across = ("far left", "left", "right", "far right")[min(int(column_share * COLUMNS), COLUMNS - 1)]
    down = ("at the top", "half-way down", "at the bottom")[min(int(row_share * ROWS), ROWS - 1)]
    return f"{across}, {down}"
