"""The instrument: its state, its events, and its commands.

One thread owns the hardware and calls `step` repeatedly. Commands come from any thread and are executed by
the next step. CPU and disk work goes to the executor, so that a press never waits for it.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from datetime import datetime
from functools import wraps
from pathlib import Path
from typing import Any, Concatenate, Final, ParamSpec, Self, TypeVar

from msgspec import structs

from device.acquisition.precise_capture import mode_fault
from device.bundles.scan import Annotations, Retake
from device.errors import DeviceError, RecordError
from device.guidance.placement import Target
from device.instrument.active_setup import ActiveSetup, gel_state
from device.instrument.calibration_run import BALL_RADIUS_MM
from device.instrument.events import Event, Failed, Info
from device.instrument.history import DeletedScans, History, ScanLabels, read_history, read_quick_look
from device.instrument.pairing_run import NetworkInfo, PairingRun, network_info
from device.instrument.spot_search import FIRST
from device.instrument.state import CalibrationState, GelState, HealthState, InstrumentState, SpotState, StateStore
from device.instrument.worker import InstrumentWorker
from device.machine.interfaces import Machine
from device.machine.machines import real_machine, twin_machine
from device.pairing_service import PairingSetup
from device.store.choices import (
    SETTINGS,
    Opinion,
    ScanMark,
    Settings,
    add_preset,
    known_gels,
    read_presets,
    read_settings,
    read_sticky,
    write_mark,
)
from device.store.registry import CalibrationRegistry, RegisteredCalibration
from device.store.store import BundleStore
from device.store.transfers import StickExport, export_to_stick, find_stick
from device.surface import HeightMap
from hal.clock import VirtualClock
from hal.errors import HalError
from hal.hardware import Hardware
from hal.interfaces import FaultName, LiftOff, PressObject, SetFault

MAX_PART: Final = 80
"""Characters of a part's name, as its field on the screen."""

Arguments = ParamSpec("Arguments")

Result = TypeVar("Result")


def _command(
    work: Callable[Concatenate[InstrumentWorker, Arguments], None],
) -> Callable[Concatenate[Instrument, Arguments], None]:
    """Return the method that lets the next step do the work of this method of its worker."""

    @wraps(work)
    def enqueue(instrument: Instrument, /, *args: Arguments.args, **kwargs: Arguments.kwargs) -> None:
        instrument._worker.enqueue(lambda worker: work(worker, *args, **kwargs))

    return enqueue


def _maintenance(
    work: Callable[Concatenate[ActiveSetup, Arguments], None],
) -> Callable[Concatenate[Instrument, Arguments], None]:
    """Return the method that lets the next step do this work on gel, calibration or zero."""

    @wraps(work)
    def maintain(worker: InstrumentWorker, /, *args: Arguments.args, **kwargs: Arguments.kwargs) -> None:
        worker.maintain(lambda setup: work(setup, *args, **kwargs))

    return _command(maintain)


class Instrument:
    """The handheld without a user interface. A context manager: entering makes it ready, leaving waits for work.

    Parameters
    ----------
    hardware : not entered; the instrument enters and leaves it
    store : of scans and calibrations
    executor : for CPU and disk work; default: one thread, or inline in virtual time
    pairing : how workstations reach the device; default: as installed
    ball_radius_mm : of the ball for calibrations that the button starts
    stick : finds the mounted USB stick
    machine : its clock, network and brightness; default: this computer's, or the twin's own
    """

    def __init__(
        self,
        hardware: Hardware,
        store: BundleStore,
        executor: Executor | None = None,
        pairing: PairingSetup | None = None,
        ball_radius_mm: float = BALL_RADIUS_MM,
        stick: Callable[[], Path] = find_stick,
        machine: Machine | None = None,
    ) -> None:
        self._stick = stick
        self.machine = machine or (twin_machine() if hardware.profile.driver == "twin" else real_machine())
        self._hardware = hardware
        self._setup = pairing or PairingSetup()
        virtual = isinstance(hardware.clock, VirtualClock)
        self._store = store
        self._ball_radius_mm = ball_radius_mm
        self._states = StateStore(_first_state(hardware, store))
        working = executor or (InlineExecutor() if virtual else ThreadPoolExecutor(1, "processing"))
        window = PairingRun(self._states, store, hardware.clock, self._setup)
        self._labels = ScanLabels(self._states, store)
        self._deleted = DeletedScans(self._states, store)
        self._worker = InstrumentWorker(
            hardware, store, self._states, working, window, ball_radius_mm, self._labels, self._deleted
        )

    # State and events: from any thread.

    @property
    def state(self) -> InstrumentState:
        """The present state: an immutable value."""
        return self._states.state

    def take_events(self) -> tuple[Event, ...]:
        """Return the events since the last call, oldest first."""
        return self._states.take_events()

    # Commands: from any thread, executed by the next step; their methods say what they do.

    press = _command(InstrumentWorker.press)
    cover_area = _command(InstrumentWorker.cover_area)
    end_guiding = _command(InstrumentWorker.end_guiding)
    redirect_button = _command(InstrumentWorker.redirect_button)
    cancel_run = _command(InstrumentWorker.cancel_run)
    run_selftest = _command(InstrumentWorker.selftest)
    ask_about_checks = _command(InstrumentWorker.ask_about_checks)
    answer_check = _command(InstrumentWorker.answer_check)
    read_focus = _command(InstrumentWorker.read_focus)
    read_levels = _command(InstrumentWorker.read_levels)
    open_pairing = _command(InstrumentWorker.open_pairing)
    open_pairing_when_new = _command(InstrumentWorker.open_pairing_when_new)
    power_off = _command(InstrumentWorker.power_off)

    # Of gel, calibration and zero: `Failed` during a calibration or an exposure balance.

    forget_balance = _maintenance(ActiveSetup.forget_balance)
    set_standard = _maintenance(ActiveSetup.set_standard)
    begin_check = _maintenance(ActiveSetup.begin_check)
    zero_check = _maintenance(ActiveSetup.check_zero)
    change_gel = _maintenance(ActiveSetup.change_gel)
    roll_back = _maintenance(ActiveSetup.roll_back)
    activate = _maintenance(ActiveSetup.activate)

    def demonstrate(self, name: str, way: tuple[float, float, float] | None = None, *, pushes: bool = True) -> None:
        """Let the twin's operator press an object of its gallery; no effect on a real board.

        way, pushes : as in `PressObject`
        """
        self._worker.enqueue(lambda worker: worker.hardware.operator.ask(PressObject(name, way, pushes)))

    def lift(self) -> None:
        """Let the twin's operator lift off and push the button; no effect on a real board."""
        self._worker.enqueue(lambda worker: worker.hardware.operator.ask(LiftOff()))

    def set_fault(self, name: FaultName, on: bool) -> None:
        """Let the twin show a fault, or no longer; no effect on a real board."""
        self._worker.enqueue(lambda worker: worker.hardware.operator.ask(SetFault(name, on)))

    def set_sticky(self, annotations: Annotations) -> None:
        """Set job, part, operator and note of every later scan, also after a restart."""
        self._labels.set(annotations)

    def retake(self) -> None:
        """The next scan replaces the last one, with its job and part; once more: it does not."""
        state = self._states.state
        if state.processing:
            self._states.publish(Failed("the last press is still being judged: try again in a moment"))
        elif state.last is None:
            self._states.publish(Failed("there is no scan to take again yet: scan first"))
        elif state.replaces:
            self._states.update(replaces=None)
            self._states.publish(Info("The next press is one more scan."))
        else:
            last = state.last
            self._states.update(replaces=Retake(last.scan_id, last.counter, last.verdict.level, last.annotations))
            self._states.publish(Info(f"Press again: the next scan replaces #{last.counter}."))

    def find_spot(self, scan_id: str, counter: int) -> None:
        """Say the way back to a scan's spot at later pushes, which then store nothing, until `end_guiding`.

        Raises
        ------
        RecordError
            The scan does not exist, is damaged, or has no quick look.
        """
        height = self.quick_look(scan_id)
        if height is None:
            raise RecordError(f"scan #{counter} has no quick look: choose a scan that has one")
        spot, target = SpotState(scan_id, counter, height, FIRST), Target(height)
        self._worker.enqueue(lambda worker: worker.find_spot(spot, target))

    def read_code(self) -> None:
        """Name the next part by the QR code or barcode that is held before the camera: `Info`, or `Failed`."""
        self._worker.enqueue(lambda worker: worker.maintain(self._name_by_code))

    def _name_by_code(self, setup: ActiveSetup) -> None:
        if (text := setup.seen_code()) is None:
            self._states.publish(Failed("no code was read: take the gel off, hold the label before the camera"))
            return
        self._labels.set(structs.replace(self._states.state.sticky, part=text[:MAX_PART]))
        self._states.publish(Info(f"The next part is {text[:MAX_PART]}."))

    def set_settings(self, settings: Settings) -> None:
        """Change the operator's settings, also after a restart; `Failed` if this hardware cannot do it."""
        if fault := mode_fault(settings.capture, self._hardware):
            self._states.publish(Failed(fault))
            return
        self._states.update(settings=settings)
        try:
            SETTINGS.write(self._store.root, settings)
        except DeviceError as error:
            self._states.publish(Failed(str(error)))

    def show_live(self, shown: bool) -> None:
        """Take live frames for a screen that shows them, or fewer."""
        self._states.update(live_shown=shown)

    def set_auto_shutter(self, on: bool) -> None:
        """Scan automatically when a contact is still."""
        self._states.update(auto_shutter=on)

    def start_calibration(self, ball_radius_mm: float) -> None:
        """Start the guided calibration; each push of the button or `press` takes its next frame."""
        self._worker.enqueue(lambda worker: worker.start_calibration(ball_radius_mm))

    def start_balance(self) -> None:
        """Start the exposure balance; each push of the button or `press` measures the ball that is pressed then."""
        self._worker.enqueue(lambda worker: worker.start_balance(self._ball_radius_mm))

    # Scans and calibrations on the disk: from any thread, immediately.

    def history(self) -> History:
        """Return every scan, newest first. Reads the disk: not for every redraw."""
        return read_history(self._store)

    def quick_look(self, scan_id: str) -> HeightMap | None:
        """Return the stored quick look of a scan; errors as for `read_quick_look`."""
        return read_quick_look(self._store, scan_id)

    def mark(self, scan_id: str, opinion: Opinion | None, note: str = "") -> None:
        """Mark a scan good or bad (None: neither) with a note; errors as for `write_mark`."""
        write_mark(self._store.root, ScanMark(scan_id=scan_id, opinion=opinion, note=note))

    def delete(self, scan_id: str) -> None:
        """Delete a scan; `undo_delete` brings it back until power off. Errors as for `delete_scan`."""
        self._deleted.delete(scan_id)
        state = self._states.state
        if state.last and state.last.scan_id == scan_id:
            self._states.update(last=None)
        if state.replaces and state.replaces.scan_id == scan_id:
            self._states.update(replaces=None)

    def undo_delete(self) -> str:
        """Bring the scan that was deleted last back; returns its id. Errors as for `DeletedScans.undo`."""
        return self._deleted.undo()

    def presets(self) -> tuple[Annotations, ...]:
        """Stored presets of job, part and operator, newest first."""
        return read_presets(self._store.root)

    def add_preset(self, preset: Annotations) -> None:
        """Store a preset; errors as for `add_preset`."""
        add_preset(self._store.root, preset)

    def wall_time(self) -> datetime:
        """Return the time by the device's clock, UTC."""
        return self._store.wall_time()

    def export_to_stick(self) -> StickExport:
        """Copy every scan to the mounted USB stick and verify it there: takes long. Errors as for `find_stick`."""
        return export_to_stick(self._store.root, self._store.device_id, self._stick(), self.wall_time())

    def gels(self) -> tuple[GelState, ...]:
        """Return every gel that was ever mounted here."""
        known = known_gels(self._store.root)
        return tuple(GelState(gel.gel_id, gel.slab_thickness_mm, gel.presses) for gel in known)

    def calibrations(self) -> tuple[RegisteredCalibration, ...]:
        """Return every calibration of the store by key and version; errors as for `CalibrationRegistry.list`."""
        return CalibrationRegistry(self._store, self._hardware.profile).list()

    def network(self) -> NetworkInfo:
        """Host name, addresses and key fingerprint of this instrument."""
        return network_info(self._setup.host_key)

    # The thread that owns the hardware.

    def __enter__(self) -> Self:
        self._worker.open()
        return self

    def __exit__(self, *exc: object) -> None:
        self._worker.close()

    def step(self) -> None:
        """Execute commands, handle the button and finished work, and take one live frame."""
        self._worker.step()


def _first_state(hardware: Hardware, store: BundleStore) -> InstrumentState:
    return InstrumentState(
        activity="out of order",
        board=hardware.profile.name,
        device_id=store.device_id,
        calibration=CalibrationState(),
        gel=gel_state(store.root, hardware),
        health=HealthState(dict.fromkeys(hardware.profile.currents_ma)),
        sticky=read_sticky(store.root),
        settings=_possible(read_settings(store.root), hardware),
        scans_stored=len(store.scans().bundles),
        sentence="starting",
    )


def _possible(settings: Settings, hardware: Hardware) -> Settings:
    """Return the settings, with presses averaged where this hardware cannot take them light by light."""
    return structs.replace(settings, capture="average") if mode_fault(settings.capture, hardware) else settings


class InlineExecutor(Executor):
    """Runs every job within `submit`, for virtual time, in which runs repeat exactly."""

    def submit(
        self, fn: Callable[Arguments, Result], /, *args: Arguments.args, **kwargs: Arguments.kwargs
    ) -> Future[Result]:
        """Return a finished future; an error of the instrument is kept in it, as in a thread's."""
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except (DeviceError, HalError) as error:
            future.set_exception(error)
        return future
