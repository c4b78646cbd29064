"""The guided calibration within the instrument: frames by button or screen, thinking on the other thread."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor, Future
from typing import Final

from device.bundle_store import BundleStore
from device.errors import DeviceError
from device.scanning.calibrate import finish, take_reference
from device.scanning.capture import CapturePlan, capture
from device.scanning.guided_calibration import GuidedCalibration
from device.session.button_watch import ButtonWatch
from device.session.cues import REFUSALS, show
from device.session.events import CalibrationStep, Failed, MayLift, PressRefused, Told
from device.session.noticeboard import Noticeboard
from hal.errors import HalError
from hal.frame import RawFrame
from hal.hardware import Hardware
from hal.interfaces import Cue

_ENDS: Final[dict[bool, tuple[Cue, Cue]]] = {False: ("good", "retake"), True: ("calibration", "refused: calibration")}
"""What is shown when it has passed and failed; where there is no screen, no cue that asks for one more press."""

PATIENCE_S: Final = 180.0
"""A calibration that the button alone began ends when nobody pushes for so long."""


class CalibrationRun:
    """One guided calibration.

    Parameters
    ----------
    hardware : with the gel that is mounted
    ball_radius_mm : of the ball that is pressed
    done : called at its end, whatever the end is
    by_button : nobody sees a screen: the indicator answers every press, and a long push, or none for
        `PATIENCE_S`, ends it
    """

    def __init__(
        self,
        hardware: Hardware,
        store: BundleStore,
        board: Noticeboard,
        executor: Executor,
        ball_radius_mm: float,
        done: Callable[[], None],
        by_button: bool = False,
    ) -> None:
        self._hardware = hardware
        self._store = store
        self._board = board
        self._executor = executor
        self._guide = GuidedCalibration(hardware.profile, ball_radius_mm)
        self.plan = CapturePlan.of_board(hardware)
        self._done = done
        self._thinking: Future[None] | None = None
        self._by_button = by_button
        self._button = ButtonWatch(hardware)
        self._awaited_ns = hardware.clock.monotonic_ns()

    def begin(self) -> None:
        """Ask for the first frame."""
        if self._by_button:
            show(self._hardware, "calibration")
        self._board.change(activity="calibrating", guide=self._guide.progress)
        self._tell()

    def press(self) -> None:
        """The button was pushed: take the frame that was asked for."""
        clock = self._hardware.clock
        if self._thinking:
            sentence = "the last frame is still being read: push again in a moment"
            self._board.tell(PressRefused(clock.monotonic_ns(), "busy", sentence))
            show(self._hardware, "refused")
            return
        show(self._hardware, "busy")
        try:
            frame = self._take()
        except (DeviceError, HalError) as error:
            self._board.tell(PressRefused(clock.monotonic_ns(), "hardware", str(error)))
            show(self._hardware, REFUSALS["hardware"])
            return
        self._board.tell(MayLift(clock.monotonic_ns()))
        show(self._hardware, "may lift")
        self._thinking = self._executor.submit(self._guide.take, frame)

    def watch_button(self, wait_s: float) -> bool:
        """Listen to the button for so long, see to what it did, and say whether it did anything.

        Raises
        ------
        ButtonError
            The button cannot be read.
        """
        happening, now_ns = self._button.look(wait_s), self._hardware.clock.monotonic_ns()
        if happening == "pushed":
            self.press()
        if happening or self._thinking:
            self._awaited_ns = now_ns
        if self._by_button and happening == "long" and self._guide.progress.phase != "fitting":
            self.cancel()
        elif self._by_button and now_ns - self._awaited_ns > PATIENCE_S * 1e9:
            self.cancel("Nobody pushed for three minutes: the calibration was stopped; the one before stays in force.")
        return happening is not None

    def _take(self) -> RawFrame:
        if self._guide.progress.phase != "reference":
            return capture(self._hardware, self.plan)
        frame, self.plan = take_reference(self._hardware, self.plan, lambda line: self._board.tell(Told(line)))
        return frame

    def step(self) -> None:
        """Go on when the thinking is over; call it many times a second."""
        if self._thinking is None or not self._thinking.done():
            return
        thought, self._thinking = self._thinking, None
        answer: Cue = "good"
        try:
            thought.result()
        except (DeviceError, HalError) as error:
            self._board.tell(Failed(str(error)))
            answer = "refused"
        self._board.change(guide=self._guide.progress)
        if self._guide.progress.is_over:
            self._board.tell(CalibrationStep(self._guide.progress))
            passed, failed = _ENDS[self._by_button]
            show(self._hardware, passed if self._guide.progress.phase == "passed" else failed)
            self._done()
        elif self._guide.progress.phase == "fitting":
            self._board.tell(CalibrationStep(self._guide.progress))
            self._thinking = self._executor.submit(self._fit)
        else:
            show(self._hardware, "retake" if self._guide.progress.complaint else answer)
            self._tell()

    def cancel(self, sentence: str = "The calibration was stopped; the one before stays in force.") -> None:
        """End it; the calibration before stays in force."""
        self._guide.fail(sentence)
        self._board.change(guide=self._guide.progress)
        self._board.tell(CalibrationStep(self._guide.progress))
        if self._by_button:
            show(self._hardware, "refused: calibration")
        self._done()

    def _fit(self) -> None:
        try:
            finish(self._hardware, self._store, self.plan, self._guide)
        except DeviceError as error:
            self._guide.fail(str(error))

    def _tell(self) -> None:
        self._board.tell(CalibrationStep(self._guide.progress))
        self._hardware.operator.ask(self._guide.request)
