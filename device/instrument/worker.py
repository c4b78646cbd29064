"""The thread that owns the hardware: commands, button, calibration and live stream, one step after another."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from contextlib import suppress
from functools import partial
from queue import Empty, SimpleQueue
from typing import Final

from device.acquisition.calibrate import check_room
from device.acquisition.selftest import root_fault, selftest
from device.errors import DeviceError, StoreError
from device.guidance.placement import Target
from device.instrument.active_setup import ActiveSetup
from device.instrument.button import LONG_PUSH_S, ButtonEvent, LongPressHandler
from device.instrument.calibration_run import BalanceRun, CalibrationRun
from device.instrument.events import REFUSALS, ButtonPushed, Failed, Info, PowerOffRequested, SelfTested, show
from device.instrument.health import EMPTY_FRACTION, EMPTY_READINGS, alarm_kinds, alarms
from device.instrument.history import DeletedScans, ScanLabels
from device.instrument.live import LiveLoop, focus_figure_of, skin_levels_of
from device.instrument.pairing_run import PairingRun
from device.instrument.scan_queue import ScanQueue, Source
from device.instrument.spot_search import AreaCover, SpotSearch
from device.instrument.state import SpotState, StateStore
from device.io.system import give_back_memory
from device.store.store import BundleStore
from hal.errors import CameraStuck, HalError
from hal.hardware import Hardware
from hal.interfaces import NeverMind

RETRY_S: Final = 1.0
"""Interval between attempts to reopen hardware that does not answer."""

HOUSEKEEPING_S: Final = 5.0
"""Interval between readings of free space and supply."""

RECOVERED: Final = "all parts answer again"

NOT_NOW: Final = (
    "not possible during a calibration or an exposure balance, or while a part does not answer: finish it, or check "
    "the part"
)
STILL_JUDGED: Final = "the last press is still being judged: try again in a moment"

Command = Callable[["InstrumentWorker"], None]


class InstrumentWorker:
    """Work for the hardware's thread; any thread may enqueue commands, the next step executes them."""

    def __init__(
        self,
        hardware: Hardware,
        store: BundleStore,
        states: StateStore,
        executor: Executor,
        pairing: PairingRun,
        ball_radius_mm: float,
        labels: ScanLabels,
        deleted: DeletedScans,
    ) -> None:
        self.hardware = hardware
        self.states = states
        self._store = store
        self._executor = executor
        self._commands: SimpleQueue[Command] = SimpleQueue()
        self._live = LiveLoop(hardware, states)
        self._active = ActiveSetup(hardware, store, states, self._live, executor)
        self._pairing = pairing
        self.spot = SpotSearch(hardware, states, executor)
        self.area = AreaCover(states, executor)
        motion, asleep, long_press = self._live.motion, self._live.is_asleep, self._on_long_press
        scanner = self._active.scanner_for_press
        self._scans = ScanQueue(
            hardware, states, executor, scanner, motion, long_press, asleep, labels, deleted, self.spot
        )
        self._deleted = deleted
        self._focus = focus_figure_of(states, self._live, hardware.clock)
        self._levels = skin_levels_of(states, self._live, hardware.clock)
        calibrate = partial(self.start_calibration, ball_radius_mm, by_button=True)
        pair, has_code = self.open_pairing, lambda: pairing.shows_code
        self._long_presses = LongPressHandler(states, hardware.clock, pair, calibrate, has_code)
        self._run: CalibrationRun | BalanceRun | None = None
        self._is_open = self._redirects_long = self._redirects_short = False
        self._polled_ns: int | None = None
        self._fault = ""
        self._empty_readings = 0

    def enqueue(self, command: Command) -> None:
        """Queue a command for the next step."""
        self._commands.put(command)

    def step(self) -> None:
        """Execute commands, handle the button and finished work, and take one live frame."""
        if not self._is_open:
            self.open()
        self._execute_commands()
        if not self._is_open or self.states.state.activity == "off":
            self.hardware.clock.sleep(RETRY_S)
            return
        try:
            self._pairing.step()
            self._serve()
        except (HalError, DeviceError) as error:
            self._out_of_order(error)
        self._poll_housekeeping()

    def open(self) -> None:
        """Acquire the hardware and prepare the active calibration; failures are reported and retried later."""
        if self.states.state.activity == "off":
            return
        try:
            self.hardware.__enter__()
            self._is_open = True
            interrupted = self._scans.forget_push()
            missed = self.hardware.button.clear_presses() > 0 or interrupted
            if self._run:
                self._run.cancel()
            else:
                self._active.prepare()
        except HalError as error:
            self._out_of_order(error)
            return
        if not self._fault:
            self.states.update(activity="ready")
            show(self.hardware, "idle")
        self._polled_ns = None
        self._poll_housekeeping()
        if missed:
            self._scans.refuse("hardware", "a push was ignored while a part did not answer: push again")

    def close(self) -> None:
        """Wait for running work, switch the lights off and release the hardware."""
        self._pairing.close()
        self._scans.finish()
        self._executor.shutdown(wait=True)
        self._release()

    def press(self) -> None:
        """Act like a push of the button: scan, or take the next calibration frame."""
        if self._run:
            self._live.wake()
            self._run.press()
            self._live.lights_changed()
        else:
            self._scan("screen")

    def redirect_button(self, short_too: bool) -> None:
        """Report long pushes as `ButtonPushed`; with `short_too` also short ones, which then do not scan."""
        self._redirects_long, self._redirects_short = True, short_too

    def start_calibration(self, ball_radius_mm: float, *, by_button: bool = False) -> None:
        """Start the guided calibration; one started by button ends with a long push or without pushes for a while."""
        if self._run or not self._is_open:
            self.states.publish(Failed(NOT_NOW))
            return
        if by_button:
            self._pairing.close()
        try:
            check_room(self.hardware, self._store)
        except StoreError as error:
            self.states.publish(Failed(str(error)))
            show(self.hardware, REFUSALS["full"])
            return
        self._focus.stop()
        self._scans.forget_push()
        fitted, done = self._active.fitted(), self._end_run
        self._run = CalibrationRun(fitted, self._store, self.states, self._executor, ball_radius_mm, done, by_button)
        self._live.begin(self._run.plan, None)
        self._run.begin()

    def start_balance(self, ball_radius_mm: float) -> None:
        """Start the exposure balance."""
        if self._run or not self._is_open:
            self.states.publish(Failed(NOT_NOW))
            return
        if self.states.state.processing:
            self.states.publish(Failed(STILL_JUDGED))
            return
        self._focus.stop()
        self._scans.forget_push()
        fitted, in_use = self._active.fitted(), self._active.plan
        self._run = BalanceRun(fitted, self._store, self.states, ball_radius_mm, in_use, self._end_run)
        self._live.begin(self._run.plan, None)
        self._run.begin()

    def cancel_run(self) -> None:
        """Stop the guided calibration or the exposure balance; what was active before stays so."""
        if self._run:
            self._run.cancel()

    def selftest(self) -> None:
        """Test every part by itself, then reopen the hardware; findings come as `SelfTested`."""
        self.states.update(activity="self-test")
        self._release()
        before = None
        for finding in selftest(self.hardware):
            if before:
                self.states.publish(SelfTested(before, ended=False))
            before = finding
        if before:
            self.states.publish(SelfTested(before, ended=True))
        self.open()

    def power_off(self) -> None:
        """Finish running work, switch the lights off and report `PowerOffRequested`."""
        self.close()
        self._deleted.purge()
        self.states.update(activity="off", live=None)
        self.states.publish(PowerOffRequested())

    def maintain(self, work: Callable[[ActiveSetup], None]) -> None:
        """Work on gel, calibration or zero between presses."""
        if self._run or not self._is_open:
            self.states.publish(Failed(NOT_NOW))
            return
        self._live.wake()
        work(self._active)
        self._live.lights_changed()

    def ask_about_checks(self) -> None:
        """Report a check standard that reads as another common ball as `CheckAsked`, to be answered, from now on."""
        self._scans.asks = True

    def answer_check(self, *, is_standard: bool) -> None:
        """Answer `CheckAsked`: the ball is the standard, and the check failed; or it is not, and is pressed again."""
        self._live.wake()
        self._scans.answer_check(is_standard=is_standard)

    def find_spot(self, spot: SpotState, target: Target) -> None:
        """Compare later pushes with an earlier scan."""
        self.area.end()
        self.spot.begin(spot, target)

    def cover_area(self, width_mm: float, height_mm: float) -> None:
        """Place later scans in an area, from its upper left corner, until `end_guiding`: the state's `area`."""
        self.spot.end()
        self.area.begin(width_mm, height_mm)

    def end_guiding(self) -> None:
        """Later pushes scan as usual."""
        self.spot.end()
        self.area.end()

    def read_focus(self, on: bool) -> None:
        """Read how sharp the lens is set into the state's `focus`, live, or no longer; it ends after ten minutes."""
        if not on:
            self._focus.stop()
        elif self._run or not self._is_open:
            self.states.publish(Failed(NOT_NOW))
        else:
            self._focus.start()

    def read_levels(self, on: bool) -> None:
        """Read the light on the skin into the state's `levels`, live, or no longer; it ends after ten minutes."""
        if on and self._is_open:
            self._levels.start()
        else:
            self._levels.stop()

    def open_pairing(self) -> None:
        """Open the pairing window for two minutes, or confirm the code in the state: `PairingChanged`."""
        if self._pairing.open():
            show(self.hardware, "pairing")

    def open_pairing_when_new(self) -> None:
        """Open the pairing window if no workstation was ever paired."""
        if self._pairing.open_when_new():
            show(self.hardware, "pairing")

    def _execute_commands(self) -> None:
        with suppress(Empty):
            while True:
                command = self._commands.get_nowait()
                if self.states.state.activity == "off":
                    continue
                try:
                    command(self)
                except (DeviceError, HalError) as error:
                    self.states.publish(Failed(str(error)))

    def _serve(self) -> None:
        if finished := self._scans.collect():
            for outcome in finished:
                self.area.add(outcome)
            self._active.report_health()
            self._active.report_check()
            give_back_memory()
        self.spot.collect()
        self.area.collect()
        if self._fault:
            self._recover()
        elif self._run:
            self._step_run(self._run)
        elif self._redirects_short:
            if press := self.hardware.button.wait_for_press(self._live.wait_s()):
                self.states.publish(ButtonPushed(press.held_s >= LONG_PUSH_S))
        elif self._scans.watch_button(self._live.wait_s()):
            self._after_press()
        live = self._live.step()
        self._focus.step(live)
        self._levels.step(live)
        if live is None or self._run or self.states.state.focus:
            return
        self._active.check_baseline(live)
        if self.states.state.auto_shutter and self._live.fires(live.reading):
            self._scan("auto-shutter")

    def _recover(self) -> None:
        """After a failure: ready again only when the camera delivers too, which a reopened one may not do."""
        self._live.step()
        self._fault = ""
        self.states.update(activity="ready", sentence=RECOVERED)
        self.states.publish(Info(RECOVERED))
        show(self.hardware, "idle")

    def _after_press(self) -> None:
        """The lights may be off after a press, and a baseline check is due."""
        self._live.lights_changed()
        self._live.wake()
        self._active.request_baseline()

    def _scan(self, source: Source) -> None:
        self._scans.scan(source)
        self._after_press()

    def _step_run(self, run: CalibrationRun | BalanceRun) -> None:
        if run.watch_button(self._live.wait_s()):
            self._live.wake()
            self._live.lights_changed()
        run.step()

    def _end_run(self) -> None:
        self._run = None
        self.hardware.operator.ask(NeverMind())  # a push that was asked for and not needed would take a scan
        with suppress(HalError):
            self.hardware.button.clear_presses()  # the last push may be down still: its release is no push of its own
        self.states.update(activity="ready")
        self._active.prepare()

    def _on_long_press(self, event: ButtonEvent) -> None:
        if event == "off":
            self.enqueue(InstrumentWorker.power_off)
        elif self._redirects_long:  # a screen switches off in its Set-up, where it asks first
            self._scans.forget_push()
            self.states.publish(ButtonPushed(held_long=True))
        else:
            self._long_presses.on_long_press()

    def _out_of_order(self, error: Exception) -> None:
        """Release all hardware after a failure and retry later; what only a new process can open ends the program.

        Presses in memory are stored without waiting.
        """
        self._scans.collect(waits=False)
        self._release()
        if isinstance(error, CameraStuck):
            raise error
        if self._fault != str(error):
            self.states.publish(Failed(str(error)))
        self._fault = str(error)
        self.states.update(activity="out of order", sentence=str(error), live=None)
        self.hardware.clock.sleep(RETRY_S)

    def _release(self) -> None:
        self._is_open = False
        with suppress(HalError):
            self.hardware.__exit__(None, None, None)

    def _poll_housekeeping(self) -> None:
        """Read free space, supply and the calibration's age from time to time, and follow other programs' changes."""
        now_ns = self.hardware.clock.monotonic_ns()
        if self._polled_ns is not None and now_ns - self._polled_ns < HOUSEKEEPING_S * 1e9:
            return
        self._polled_ns = now_ns
        with suppress(HalError):
            self.states.update(power=self.hardware.power.read())
        self.states.update(scans_left=self._active.scans_left())
        self._raise_alarms()
        self._active.report_age()
        self._active.report_due()
        if self._is_open and not self._run:
            self._active.follow()

    def _raise_alarms(self) -> None:
        """Announce new alarms; stop in order once the battery is nearly empty."""
        state = self.states.state
        found = alarms(state.power, state.scans_left, root_fault())
        for sentence in found:
            if not alarm_kinds((sentence,)) <= alarm_kinds(state.alarms):
                self.states.publish(Failed(sentence))
        self.states.update(alarms=found)
        charge = state.power.battery_share
        self._empty_readings = self._empty_readings + 1 if charge is not None and charge <= EMPTY_FRACTION else 0
        if self._empty_readings >= EMPTY_READINGS:
            self.power_off()
