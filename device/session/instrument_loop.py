"""The thread that owns the hardware: button, live stream, calibration and commands, one step after the other."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from contextlib import suppress
from functools import partial
from queue import Empty, SimpleQueue
from typing import Final

from device.bundle_store import BundleStore
from device.errors import DeviceError
from device.scanning.selftest import selftest
from device.session.button_watch import LONG_PUSH_S
from device.session.calibration_run import CalibrationRun
from device.session.cues import show
from device.session.events import ButtonPushed, Failed, PowerOffAsked, SelfTested
from device.session.in_force import InForce
from device.session.live_loop import LiveLoop
from device.session.long_push import LongPush
from device.session.noticeboard import Noticeboard
from device.session.pairing_run import PairingRun
from device.session.press_cycle import PressCycle, Source
from hal.errors import HalError
from hal.hardware import Hardware

RETRY_S: Final = 1.0
"""A part that does not answer is tried again so often."""

HOUSEKEEPING_S: Final = 5.0
"""Room and supply are read again so often."""

NOT_NOW: Final = "not now: a calibration is going on, or a part does not answer: end it, or see to the part"

Command = Callable[["InstrumentLoop"], None]


class InstrumentLoop:
    """What only one thread may do; commands are queued by any thread and carried out by the next step."""

    def __init__(
        self,
        hardware: Hardware,
        store: BundleStore,
        board: Noticeboard,
        executor: Executor,
        pairing: PairingRun,
        ball_radius_mm: float,
    ) -> None:
        self.hardware = hardware
        self.board = board
        self._store = store
        self._executor = executor
        self._commands: SimpleQueue[Command] = SimpleQueue()
        self._live = LiveLoop(hardware, board)
        self._in_force = InForce(hardware, store, board, self._live, executor)
        self._pairing = pairing
        self._presses = PressCycle(
            hardware, board, executor, self._in_force.scanner_for_press, self._live.motion, self._long_push
        )
        calibrate = partial(self.start_calibration, ball_radius_mm, by_button=True)
        self._held = LongPush(board, hardware.clock, self.open_pairing, calibrate)
        self._run: CalibrationRun | None = None
        self._is_open = self._long_lent = self._short_lent = False
        self._house_ns: int | None = None

    def ask(self, command: Command) -> None:
        """Queue a command."""
        self._commands.put(command)

    def step(self) -> None:
        """Carry out commands, see to the button and to finished work, and take one live frame."""
        if not self._is_open:
            self.open()
        self._carry_out()
        if not self._is_open or self.board.state.activity == "off":
            self.hardware.clock.sleep(RETRY_S)
            return
        try:
            self._pairing.step()
            self._look()
        except (HalError, DeviceError) as error:
            self._out_of_order(error)
        self._keep_house()

    def open(self) -> None:
        """Acquire the hardware and prepare the calibration in force; what fails is told and tried again."""
        if self.board.state.activity == "off":
            return
        try:
            self.hardware.__enter__()
            self._is_open = True
            missed = self.hardware.button.forget_presses()
            if self._run:
                self._run.cancel()
            else:
                self._in_force.prepare()
        except HalError as error:
            self._out_of_order(error)
            return
        self.board.change(activity="ready")
        self._house_ns = None
        self._keep_house()
        show(self.hardware, "idle")
        if missed:
            self._presses.refuse("hardware", "a push came while a part did not answer and did nothing: push again")

    def close(self) -> None:
        """Wait for what is in work and give the hardware back, lights dark."""
        self._pairing.close()
        self._executor.shutdown(wait=True)
        self._presses.collect()
        self._release()

    def press(self) -> None:
        """A push of the screen's button."""
        self._live.wake()
        if self._run:
            self._run.press()
            self._live.darkened()
        else:
            self._scan("screen")

    def lend_button(self, short_too: bool) -> None:
        """Tell a face of long pushes from now on, and of short ones in the place of a scan."""
        self._long_lent, self._short_lent = True, short_too

    def start_calibration(self, ball_radius_mm: float, *, by_button: bool = False) -> None:
        """Begin the guided calibration; begun by the button, a long push ends it, or none for a while."""
        if self._run or not self._is_open:
            self.board.tell(Failed(NOT_NOW))
            return
        if by_button:
            self._pairing.close()
        fitted, done = self._in_force.fitted(), self._end_calibration
        self._run = CalibrationRun(fitted, self._store, self.board, self._executor, ball_radius_mm, done, by_button)
        self._live.begin(self._run.plan, None)
        self._run.begin()

    def cancel_calibration(self) -> None:
        """Stop the guided calibration."""
        if self._run:
            self._run.cancel()

    def selftest(self) -> None:
        """Test every part by itself; the hardware is opened anew afterwards."""
        self.board.change(activity="self-test")
        self._release()
        before = None
        for finding in selftest(self.hardware):
            if before:
                self.board.tell(SelfTested(before, ended=False))
            before = finding
        if before:
            self.board.tell(SelfTested(before, ended=True))
        self.open()

    def power_off(self) -> None:
        """Finish what is in work, go dark and say so."""
        self.close()
        self.board.change(activity="off", live=None)
        self.board.tell(PowerOffAsked())

    def maintain(self, work: Callable[[InForce], None]) -> None:
        """Something that is done with gel, calibration or zero, between presses."""
        if self._run or not self._is_open:
            self.board.tell(Failed(NOT_NOW))
            return
        self._live.wake()
        work(self._in_force)
        self._live.darkened()

    def open_pairing(self) -> None:
        """Let a workstation come."""
        if self._pairing.open():
            show(self.hardware, "pairing")

    def _carry_out(self) -> None:
        """What was asked for since the last step; what cannot be done is told."""
        with suppress(Empty):
            while True:
                command = self._commands.get_nowait()
                if self.board.state.activity == "off":
                    continue
                try:
                    command(self)
                except (DeviceError, HalError) as error:
                    self.board.tell(Failed(str(error)))

    def _look(self) -> None:
        if self._presses.collect():
            self._in_force.report_health()
        if self._run:
            self._step_calibration(self._run)
        elif self._short_lent:
            if press := self.hardware.button.wait_for_press(0.0):
                self.board.tell(ButtonPushed(press.held_s >= LONG_PUSH_S))
        elif self._presses.watch_button(self._live.wait_s()):
            self._disturbed()
        live = self._live.step()
        if live is None or self._run:
            return
        self._in_force.look(live)
        if self.board.state.auto_shutter and self._live.fires(live.reading):
            self._scan("auto-shutter")

    def _disturbed(self) -> None:
        """A press was seen to: the lights may be dark, and untouched skin is worth a look afterwards."""
        self._live.darkened()
        self._live.wake()
        self._in_force.want_look()

    def _scan(self, source: Source) -> None:
        self._presses.scan(source)
        self._disturbed()

    def _step_calibration(self, run: CalibrationRun) -> None:
        if run.watch_button(self._live.wait_s()):
            self._live.wake()
            self._live.darkened()
        run.step()

    def _end_calibration(self) -> None:
        self._run = None
        self.board.change(activity="ready")
        self._in_force.prepare()

    def _long_push(self) -> None:
        """Tell a face, which leads through its screens; without one it asks for something itself."""
        if self._long_lent:
            self.board.tell(ButtonPushed(held_long=True))
        else:
            self._held.happened()

    def _out_of_order(self, error: Exception) -> None:
        """A part does not answer: let go of everything and try again later."""
        self._release()
        if self.board.state.activity != "out of order" or self.board.state.sentence != str(error):
            self.board.tell(Failed(str(error)))
        self.board.change(activity="out of order", sentence=str(error), live=None)
        self.hardware.clock.sleep(RETRY_S)

    def _release(self) -> None:
        self._is_open = False
        with suppress(HalError):
            self.hardware.__exit__(None, None, None)

    def _keep_house(self) -> None:
        """Read room, supply and the calibration's age again from time to time."""
        now_ns = self.hardware.clock.monotonic_ns()
        if self._house_ns is not None and now_ns - self._house_ns < HOUSEKEEPING_S * 1e9:
            return
        self._house_ns = now_ns
        with suppress(HalError):
            self.board.change(power=self.hardware.power.read())
        self.board.change(scans_left=self._in_force.scans_left())
        self._in_force.report_age()
        if self._is_open and not self._run:
            self._in_force.follow()
