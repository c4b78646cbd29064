"""The instrument: what it is (`state`), what happens (`take_events`), and everything it can be told to do.

One thread owns the hardware and calls `step` again and again (or `run`); commands come from any thread and are carried
out within a step. What takes the processor or the disk is handed to the executor, so that a press never waits for it.
"""

from __future__ import annotations

from concurrent.futures import Executor, ThreadPoolExecutor
from threading import Event as Flag
from typing import Final, Self

from device.bundle_store import BundleStore
from device.calibration_shelf import CalibrationShelf, Shelved
from device.gel_log import known_gels
from device.pairing.opening import PairingSetup
from device.scan_bundle import Annotations
from device.scan_marks import Opinion, ScanMark, write_mark
from device.session.at_once import AtOnce
from device.session.described import gel_state
from device.session.events import Event
from device.session.history import History, read_history, read_quick_look
from device.session.in_force import InForce
from device.session.instrument_loop import InstrumentLoop
from device.session.network import NetworkFacts, network_facts
from device.session.noticeboard import Noticeboard
from device.session.pairing_run import PairingRun
from device.session.state import CalibrationState, GelState, HealthState, InstrumentState
from device.surface import HeightMap
from hal.clock import VirtualClock
from hal.hardware import Hardware
from hal.interfaces import LiftOff, PressObject

BALL_RADIUS_MM: Final = 3.0
"""Radius of the ball where none is stated."""


class Instrument:
    """The handheld without a face. A context manager: entering makes it ready, leaving waits for what is in work.

    Parameters
    ----------
    hardware : not entered; the instrument enters and leaves it
    store : where scans and calibrations are
    executor : does what takes the processor; a thread of its own when none is given, and none in virtual time
    pairing : how workstations reach it; as the installed service has it when none is given
    ball_radius_mm : of the ball of a calibration that the button alone begins
    """

    def __init__(
        self,
        hardware: Hardware,
        store: BundleStore,
        executor: Executor | None = None,
        pairing: PairingSetup | None = None,
        ball_radius_mm: float = BALL_RADIUS_MM,
    ) -> None:
        self._hardware = hardware
        self._setup = pairing or PairingSetup()
        virtual = isinstance(hardware.clock, VirtualClock)
        self._store = store
        self._board = Noticeboard(_first_state(hardware, store))
        working = executor or (AtOnce() if virtual else ThreadPoolExecutor(1, "processing"))
        window = PairingRun(self._board, store, hardware.clock, self._setup)
        self._loop = InstrumentLoop(hardware, store, self._board, working, window, ball_radius_mm)

    # What it is and what happens: from any thread.

    @property
    def state(self) -> InstrumentState:
        """The present state: an immutable value."""
        return self._board.state

    def take_events(self) -> tuple[Event, ...]:
        """What happened since the last call, oldest first."""
        return self._board.take_events()

    # Commands: from any thread, carried out by the next step.

    def press(self) -> None:
        """The same as a push of the button: a scan, or the next step of a calibration."""
        self._loop.ask(InstrumentLoop.press)

    def demonstrate(self, name: str) -> None:
        """Have the twin's operator press an object of its gallery and push its button; a person is asked nothing."""
        self._loop.ask(lambda loop: loop.hardware.operator.ask(PressObject(name)))

    def lift(self) -> None:
        """Have the twin's operator lift off and push its button."""
        self._loop.ask(lambda loop: loop.hardware.operator.ask(LiftOff()))

    def set_sticky(self, annotations: Annotations) -> None:
        """Job, part, operator and note of every scan from now on."""
        self._board.change(sticky=annotations)

    def lend_button(self, short_too: bool) -> None:
        """Tell long pushes of the button as `ButtonPushed`, and short ones too in the place of a scan: a face leads
        through its screens with them."""
        self._loop.ask(lambda loop: loop.lend_button(short_too))

    def set_auto_shutter(self, on: bool) -> None:
        """Scan by itself when a contact is still."""
        self._board.change(auto_shutter=on)

    def start_calibration(self, ball_radius_mm: float) -> None:
        """Begin the guided calibration; each of its steps is a push of the button or `press`."""
        self._loop.ask(lambda loop: loop.start_calibration(ball_radius_mm))

    def cancel_calibration(self) -> None:
        """Stop the guided calibration; the one before stays in force."""
        self._loop.ask(InstrumentLoop.cancel_calibration)

    def run_selftest(self) -> None:
        """Test every part; findings come as events."""
        self._loop.ask(InstrumentLoop.selftest)

    def zero_check(self) -> None:
        """Take a frame of the untouched skin: `ZeroChecked` says how flat it reads."""
        self._loop.ask(lambda loop: loop.maintain(InForce.check_zero))

    def change_gel(self, gel_id: str, slab_thickness_mm: float | None = None) -> None:
        """Another gel is mounted: its calibration comes into force (`Told`), or scans are refused (`Failed`)."""
        self._loop.ask(lambda loop: loop.maintain(lambda now: now.change_gel(gel_id, slab_thickness_mm)))

    def roll_back(self) -> None:
        """Put the calibration before this one in force: `Told`, or `Failed` when there is none."""
        self._loop.ask(lambda loop: loop.maintain(InForce.roll_back))

    def put_in_force(self, calibration_id: str) -> None:
        """Put a calibration of the shelf in force: `Told`, or `Failed` when it is foreign, stale or damaged."""
        self._loop.ask(lambda loop: loop.maintain(lambda now: now.put_in_force(calibration_id)))

    def open_pairing(self) -> None:
        """Open the pairing window for two minutes: `PairingChanged`, and the code in the state."""
        self._loop.ask(InstrumentLoop.open_pairing)

    def power_off(self) -> None:
        """Finish what is in work, go dark and say so with `PowerOffAsked`."""
        self._loop.ask(InstrumentLoop.power_off)

    # The scans on the disk: from any thread, done at once.

    def history(self) -> History:
        """Every scan, the newest first. Reads the disk: not for every redraw."""
        return read_history(self._store)

    def quick_look(self, scan_id: str) -> HeightMap | None:
        """The stored quick look of a scan; errors as for `read_quick_look`."""
        return read_quick_look(self._store, scan_id)

    def mark(self, scan_id: str, opinion: Opinion | None, note: str = "") -> None:
        """Mark a scan good or bad (None: neither) and note something; errors as for `write_mark`."""
        write_mark(self._store.root, ScanMark(scan_id=scan_id, opinion=opinion, note=note))

    def gels(self) -> tuple[GelState, ...]:
        """Every gel that was mounted here."""
        known = known_gels(self._store.root)
        return tuple(GelState(gel.gel_id, gel.slab_thickness_mm, gel.presses) for gel in known)

    def calibrations(self) -> tuple[Shelved, ...]:
        """Every calibration of the store by place and version; errors as for `CalibrationShelf.shelved`."""
        return CalibrationShelf(self._store, self._hardware.profile).shelved()

    def network(self) -> NetworkFacts:
        """Name, addresses and key fingerprint of this instrument."""
        return network_facts(self._setup.host_key)

    # The thread that owns the hardware.

    def __enter__(self) -> Self:
        self._loop.open()
        return self

    def __exit__(self, *exc: object) -> None:
        self._loop.close()

    def step(self) -> None:
        """Carry out commands, see to the button and to finished work, and take one live frame."""
        self._loop.step()

    def run(self, stop: Flag) -> None:
        """Step until told to stop."""
        while not stop.is_set():
            self.step()


def _first_state(hardware: Hardware, store: BundleStore) -> InstrumentState:
    return InstrumentState(
        activity="out of order",
        board=hardware.profile.name,
        device_id=store.device_id,
        calibration=CalibrationState(),
        gel=gel_state(store.root, hardware),
        health=HealthState(dict.fromkeys(hardware.profile.currents_ma)),
        scans_stored=len(store.scans().bundles),
        sentence="starting",
    )
