"""The guided calibration in the instrument: frames by button or screen, computation on the other thread."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor, Future
from typing import Final

from device.acquisition.auto_exposure import ExposureSearch, calibration_settings, keep_balance
from device.acquisition.calibrate import finish, last_calibration, take_reference
from device.acquisition.capture import CaptureSettings, capture
from device.acquisition.guided_calibration import GuidedCalibration
from device.errors import DeviceError
from device.instrument.button import ButtonWatch
from device.instrument.events import REFUSALS, CalibrationStep, CaptureDone, Failed, Info, PressRefused, show
from device.instrument.state import BalanceProgress, StateStore
from device.store.store import BundleStore
from hal.errors import HalError
from hal.frame import RawFrame
from hal.hardware import Hardware
from hal.interfaces import Cue

_ENDS: Final[dict[bool, tuple[Cue, Cue]]] = {False: ("good", "retake"), True: ("calibration", "refused: calibration")}
"""Cues for passed and failed; without a screen none that would ask for one more press."""

IDLE_TIMEOUT_S: Final = 180.0
"""A calibration started by the button ends after this long without a push."""


class CalibrationRun:
    """One guided calibration.

    Parameters
    ----------
    hardware : with the mounted gel
    ball_radius_mm : of the calibration ball
    done : called at its end, passed or not
    by_button : no screen: the indicator answers every press, and a long push, or none for `IDLE_TIMEOUT_S`, ends it
    """

    def __init__(
        self,
        hardware: Hardware,
        store: BundleStore,
        states: StateStore,
        executor: Executor,
        ball_radius_mm: float,
        done: Callable[[], None],
        by_button: bool = False,
    ) -> None:
        self._hardware = hardware
        self._store = store
        self._states = states
        self._executor = executor
        self.plan = calibration_settings(hardware, store.root)
        last = last_calibration(hardware, store, self.plan)
        self._guide = GuidedCalibration(hardware.profile, ball_radius_mm, last)
        self._done = done
        self._computing: Future[None] | None = None
        self._by_button = by_button
        self._button = ButtonWatch(hardware)
        self._active_ns = hardware.clock.monotonic_ns()

    def begin(self) -> None:
        """Ask for the first frame."""
        if self._by_button:
            show(self._hardware, "calibration")
        self._states.update(activity="calibrating", guide=self._guide.progress)
        self._ask()

    def press(self) -> None:
        """Take the requested frame, after a push of the button."""
        clock = self._hardware.clock
        if self._computing:
            sentence = "the last frame is still being processed: push again in a moment"
            self._states.publish(PressRefused(clock.monotonic_ns(), "busy", sentence))
            show(self._hardware, "refused")
            return
        show(self._hardware, "busy")
        try:
            frame = self._capture()
        except (DeviceError, HalError) as error:
            self._states.publish(PressRefused(clock.monotonic_ns(), "hardware", str(error)))
            show(self._hardware, REFUSALS["hardware"])
            return
        self._states.publish(CaptureDone(clock.monotonic_ns()))
        show(self._hardware, "may lift")
        self._computing = self._executor.submit(self._guide.add_frame, frame)

    def watch_button(self, wait_s: float) -> bool:
        """Wait for the button up to `wait_s`, handle its events, and return whether there was one.

        Raises
        ------
        ButtonError
            The button cannot be read.
        """
        event, now_ns = self._button.wait(wait_s), self._hardware.clock.monotonic_ns()
        if event == "pushed":
            self.press()
        if event or self._computing:
            self._active_ns = now_ns
        if self._by_button and event == "long" and self._guide.progress.phase != "fitting":
            self.cancel()
        elif self._by_button and now_ns - self._active_ns > IDLE_TIMEOUT_S * 1e9:
            self.cancel("No push for three minutes: calibration stopped; the previous one stays active.")
        return event is not None

    def _capture(self) -> RawFrame:
        if self._guide.progress.phase != "reference":
            return capture(self._hardware, self.plan)
        frame, self.plan = take_reference(self._hardware, self.plan, lambda line: self._states.publish(Info(line)))
        return frame

    def step(self) -> None:
        """Continue when the computation has finished; call it many times a second."""
        if self._computing is None or not self._computing.done():
            return
        finished, self._computing = self._computing, None
        answer: Cue = "good"
        try:
            finished.result()
        except (DeviceError, HalError) as error:
            self._states.publish(Failed(str(error)))
            answer = "refused"
        self._states.update(guide=self._guide.progress)
        if self._guide.progress.is_over:
            self._states.publish(CalibrationStep(self._guide.progress))
            passed, failed = _ENDS[self._by_button]
            show(self._hardware, passed if self._guide.progress.phase == "passed" else failed)
            self._done()
        elif self._guide.progress.phase == "fitting":
            self._states.publish(CalibrationStep(self._guide.progress))
            self._computing = self._executor.submit(self._fit)
        else:
            show(self._hardware, "retake" if self._guide.progress.complaint else answer)
            self._ask()

    def cancel(self, sentence: str = "Calibration stopped; the previous one stays active.") -> None:
        """End the calibration as failed."""
        self._guide.fail(sentence)
        self._states.update(guide=self._guide.progress)
        self._states.publish(CalibrationStep(self._guide.progress))
        if self._by_button:
            show(self._hardware, "refused: calibration")
        self._done()

    def _fit(self) -> None:
        try:
            finish(self._hardware, self._store, self.plan, self._guide)
        except DeviceError as error:
            self._guide.fail(str(error))

    def _ask(self) -> None:
        self._states.publish(CalibrationStep(self._guide.progress))
        self._hardware.operator.ask(self._guide.request)


# The exposure balance in the instrument: one ball press near each light; the next calibration uses what was found.

KEPT = "The active calibration keeps its own light, so scans stay as they are; the next calibration uses the new one."
STOPPED = "Exposure balance stopped: nothing has changed."


class BalanceRun:
    """One exposure balance; the hardware's thread steps it like a calibration.

    Parameters
    ----------
    hardware : with the mounted gel
    ball_radius_mm : of the ball
    in_use : settings of the active calibration; None without one
    done : called at its end
    """

    def __init__(
        self,
        hardware: Hardware,
        store: BundleStore,
        states: StateStore,
        ball_radius_mm: float,
        in_use: CaptureSettings | None,
        done: Callable[[], None],
    ) -> None:
        self._hardware = hardware
        self._store = store
        self._states = states
        self._search = ExposureSearch(hardware, ball_radius_mm, in_use or calibration_settings(hardware, store.root))
        self._done = done
        self._button = ButtonWatch(hardware)
        self.plan = self._search.plan

    def begin(self) -> None:
        """Ask for the first press."""
        self._states.update(activity="balancing")
        self._ask()

    def press(self) -> None:
        """Measure the ball that is pressed now, after a push of the button."""
        show(self._hardware, "busy")
        try:
            self._search.measure()
            if self._search.is_complete:
                self._finish()
                return
        except (DeviceError, HalError) as error:
            self._end(BalanceProgress("failed", str(error), self._search.taken))
            self._states.publish(Failed(f"exposure balance: {error}"))
            show(self._hardware, "retake")
            return
        self._states.publish(CaptureDone(self._hardware.clock.monotonic_ns()))
        show(self._hardware, "may lift")
        self._ask()

    def watch_button(self, wait_s: float) -> bool:
        """Wait for the button up to `wait_s`, measure at a push, and return whether something happened.

        Raises
        ------
        ButtonError
            The button cannot be read.
        """
        event = self._button.wait(wait_s)
        if event == "pushed":
            self.press()
        return event is not None

    def step(self) -> None:
        """Nothing is computed between presses."""

    def cancel(self) -> None:
        """Stop; nothing has changed."""
        self._end(BalanceProgress("failed", STOPPED, self._search.taken))
        self._states.publish(Info(STOPPED))

    def _ask(self) -> None:
        instruction = self._search.instruction
        progress = BalanceProgress("press", instruction[0].upper() + instruction[1:], self._search.taken)
        self._states.update(balance=progress)
        self._hardware.operator.ask(self._search.request)

    def _finish(self) -> None:
        found = self._search.result()
        keep_balance(self._hardware, self._store.root, found.plan)
        self._end(BalanceProgress("done", KEPT, self._search.taken, found))
        self._states.publish(Info(f"Exposure balanced. {KEPT}"))
        show(self._hardware, "good")

    def _end(self, progress: BalanceProgress) -> None:
        self._states.update(balance=progress)
        self._done()


# The ball that calibrates when nobody names another.

BALL_RADIUS_MM: Final = 3.0
