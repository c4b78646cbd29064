"""The guided calibration within the instrument: frames by button or screen, thinking on the other thread."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor, Future

from device.bundle_store import BundleStore
from device.errors import DeviceError
from device.scanning.calibrate import finish, take_reference
from device.scanning.capture import CapturePlan, capture
from device.scanning.guided_calibration import GuidedCalibration
from device.session.cues import REFUSALS, show
from device.session.events import CalibrationStep, Failed, MayLift, PressRefused, Told
from device.session.noticeboard import Noticeboard
from hal.errors import HalError
from hal.frame import RawFrame
from hal.hardware import Hardware


class CalibrationRun:
    """One guided calibration; `done` is called at its end, whatever the end is."""

    def __init__(
        self,
        hardware: Hardware,
        store: BundleStore,
        board: Noticeboard,
        executor: Executor,
        guide: GuidedCalibration,
        plan: CapturePlan,
        done: Callable[[], None],
    ) -> None:
        self._hardware = hardware
        self._store = store
        self._board = board
        self._executor = executor
        self._guide = guide
        self._plan = plan
        self._done = done
        self._thinking: Future[None] | None = None

    def begin(self) -> None:
        """Ask for the first frame."""
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

    def _take(self) -> RawFrame:
        if self._guide.progress.phase != "reference":
            return capture(self._hardware, self._plan)
        frame, self._plan = take_reference(self._hardware, self._plan, lambda line: self._board.tell(Told(line)))
        return frame

    def step(self) -> None:
        """Go on when the thinking is over; call it many times a second."""
        if self._thinking is None or not self._thinking.done():
            return
        thought, self._thinking = self._thinking, None
        try:
            thought.result()
        except (DeviceError, HalError) as error:
            self._board.tell(Failed(str(error)))
            show(self._hardware, "refused")
        self._board.change(guide=self._guide.progress)
        if self._guide.progress.is_over:
            self._board.tell(CalibrationStep(self._guide.progress))
            show(self._hardware, "good" if self._guide.progress.phase == "passed" else "retake")
            self._done()
        elif self._guide.progress.phase == "fitting":
            self._board.tell(CalibrationStep(self._guide.progress))
            self._thinking = self._executor.submit(self._fit)
        else:
            self._tell()

    def cancel(self) -> None:
        """End it; the calibration before stays in force."""
        self._guide.fail("The calibration was stopped; the one before stays in force.")
        self._board.change(guide=self._guide.progress)
        self._board.tell(CalibrationStep(self._guide.progress))
        self._done()

    def _fit(self) -> None:
        try:
            finish(self._hardware, self._store, self._plan, self._guide)
        except DeviceError as error:
            self._guide.fail(str(error))

    def _tell(self) -> None:
        self._board.tell(CalibrationStep(self._guide.progress))
        self._hardware.operator.ask(self._guide.request)
