"""The exposure balance in the instrument: one ball press near each light; the next calibration uses what was found."""

from __future__ import annotations

from collections.abc import Callable

from device.acquisition.auto_exposure import ExposureSearch
from device.acquisition.capture import CaptureSettings
from device.acquisition.gel_profile import calibration_settings, keep_balance
from device.errors import DeviceError
from device.instrument.button import ButtonWatch
from device.instrument.events import CaptureDone, Failed, Info, show
from device.instrument.state import BalanceProgress, StateStore
from device.store.store import BundleStore
from hal.errors import HalError
from hal.hardware import Hardware

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
