"""The active setup: the mounted gel, its calibration with its scanner, their health, and all three in the state.

A part's label is read before the camera while no gel is mounted.
"""

from __future__ import annotations

from concurrent.futures import Executor
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from device.acquisition.auto_exposure import calibration_settings
from device.acquisition.capture import CaptureSettings, capture
from device.acquisition.scan_health import ZeroCheck
from device.acquisition.scanner import Scanner
from device.bundles.calibration import CalibrationBundle
from device.bundles.check import CheckStandard
from device.errors import DeviceError
from device.imaging.flat_field import bin_bayer
from device.imaging.frame_light import Brightness
from device.instrument.events import Failed, Info, ZeroChecked, show
from device.instrument.health import BaselineScheduler, health_state, zero_sentence
from device.instrument.live import LiveFrame, LiveLoop
from device.instrument.state import CalibrationState, GelState, HealthState, NextLight, StateStore
from device.io.system import give_back_memory
from device.quality.press_faults import FLAT_RESIDUAL_UM
from device.quality.verdict import drift_complaints
from device.store.checks import read_checks, read_standard, write_standard
from device.store.choices import BALANCE, known_gel, make_gel, mount_gel, mounted_gel, with_active_gel
from device.store.registry import CalibrationRegistry
from device.store.registry_file import ACTIVE
from device.store.store import BundleStore
from hal.errors import HalError
from hal.frame import RawFrame
from hal.hardware import Hardware

Selection = tuple[str, float, bytes]
"""Mounted gel, its slab in mm, and the content of the store's active-calibration file."""


class ActiveSetup:
    """The scanner for presses, or the reason why presses cannot be scanned."""

    def __init__(
        self, hardware: Hardware, store: BundleStore, states: StateStore, live: LiveLoop, executor: Executor
    ) -> None:
        self._hardware = hardware
        self._store = store
        self._states = states
        self._live = live
        self._executor = executor
        self._scanner: Scanner | None = None
        self._fault: DeviceError | HalError | None = None
        self._baseline: BaselineScheduler | None = None
        self._zero: ZeroCheck | None = None
        self._selection: Selection | None = None

    def fitted(self) -> Hardware:
        """Return the hardware with the mounted gel. Errors as for `with_active_gel`."""
        return with_active_gel(self._hardware, self._store.root)

    def scanner(self) -> Scanner:
        """Return the active scanner.

        Raises
        ------
        DeviceError, HalError
            Why presses cannot be scanned.
        """
        if self._scanner is None:
            raise self._fault or DeviceError("the instrument is not ready yet: wait a moment")
        return self._scanner

    def scans_left(self) -> int | None:
        """Return the number of scans that fit, or that will once a press makes room; None if unknown.

        Nothing is removed.
        """
        with suppress(DeviceError, HalError):
            return self.scanner().scans_promised(self._states.state.settings.capture)
        return None

    def scanner_for_press(self) -> Scanner:
        """Return the scanner for a press that begins now, after changes by other programs. Errors as for `scanner`."""
        self.follow()
        return self.scanner()

    def follow(self) -> None:
        """Activate what another program, for example `retroscan gel`, has mounted or activated in this store."""
        if self._selection is None or self._selection == active_selection(self._store, self._hardware):
            return
        self.prepare()
        state = self._states.state
        changed = f"Changed by another program: calibration {state.calibration.calibration_id}, gel {state.gel.gel_id}."
        self._states.publish(Failed(state.calibration.fault) if state.calibration.fault else Info(changed))

    def report_age(self) -> None:
        """Update the active calibration's age in the state."""
        if self._scanner:
            age_s = calibration_age_s(self._scanner.calibration, self._store)
            self._states.update(calibration=replace(self._states.state.calibration, age_s=age_s))

    def report_check(self) -> None:
        """Update the check standard and its checks in the state."""
        root, calibration = self._store.root, self._states.state.calibration.calibration_id
        checks = tuple(check for check in read_checks(root) if check.calibration_id == calibration)
        self._states.update(check=replace(self._states.state.check, standard=read_standard(root), checks=checks))
        self.report_due()

    def report_due(self) -> None:
        """Update whether today's check is still to be made."""
        check, today = self._states.state.check, self._store.wall_time().astimezone().date()
        done = any(one.checked.astimezone().date() == today for one in check.of_standard)
        is_due = check.standard is not None and self._scanner is not None and not done
        self._states.update(check=replace(check, is_due=is_due))

    def set_standard(self, standard: CheckStandard) -> None:
        """Enter the check standard; its history stays."""
        try:
            write_standard(self._store.root, standard)
        except DeviceError as error:
            self._fail(str(error))
        self.report_check()

    def begin_check(self) -> None:
        """The next press is of the check standard, and is judged; once more: it is not."""
        self.report_check()
        check = self._states.state.check
        if check.standard is None:
            self._fail("no check standard was entered: enter it in Set-up")
            return
        self._states.update(check=replace(check, is_next=not check.is_next))
        words = "The next press is a scan again." if check.is_next else f"Press {check.standard.name}, then push."
        self._states.publish(Info(words))

    def prepare(self) -> None:
        """Load the store's active calibration for the mounted gel, or record why that fails."""
        self._scanner = self._baseline = self._zero = None
        self._selection = active_selection(self._store, self._hardware)
        self._states.update(gel=gel_state(self._store.root, self._hardware))
        try:
            fitted = self.fitted()
            self._report_next_light(fitted)
            scanner = Scanner(fitted, self._store)
            state = calibration_state(
                scanner.calibration, CalibrationRegistry(self._store, fitted.profile), self._store
            )
        except (DeviceError, HalError) as error:
            self._fault = error
            self._live.begin(CaptureSettings.of_board(self._hardware), None)
            unmeasured = HealthState(dict.fromkeys(self._hardware.profile.currents_ma))
            self._states.update(calibration=CalibrationState(fault=str(error)), health=unmeasured)
            return
        self._scanner, self._fault = scanner, None
        self._baseline = BaselineScheduler(scanner.health, self._executor)
        self._live.begin(scanner.plan, scanner.health.guide_model)
        self._states.update(calibration=state)
        self.report_check()
        self.report_health()
        give_back_memory()

    def check_baseline(self, live: LiveFrame) -> None:
        """Check untouched skin in a live frame if a check is due.

        Raises
        ------
        HalError, FrameError, FrameNotConfirmed
            The hardware failed while each light was measured alone.
        """
        if self._scanner is None or self._baseline is None:
            return
        if self._baseline.step(live):
            self.report_health()
        is_awaited = self._states.state.processing > 0
        wanted = self._baseline.wants_lights_alone(live, is_awaited=is_awaited)
        if wanted and not self._hardware.button.is_down():
            self._baseline.measured_alone(self._scanner.measure_lights())
            self._live.lights_changed()

    def request_baseline(self) -> None:
        """Request a baseline check soon, after a press."""
        if self._baseline:
            self._baseline.request()

    def report_health(self) -> None:
        """Update health and gel in the state."""
        if self._scanner is None:
            return
        health = self._scanner.health
        self._live.set_light_levels(health.channel_levels, next(drift_complaints(health.light_change, None), None))
        gel = gel_state(self._store.root, self._hardware)
        self._states.update(gel=gel, health=health_state(health, gel, self._zero))

    def check_zero(self) -> None:
        """Take a frame of untouched skin; `ZeroChecked` says how flat it reads."""
        try:
            scanner = self.scanner()
            zero = scanner.health.check_zero(scanner.capture().frame)
        except (DeviceError, HalError) as error:
            self._fail(f"zero check: {error}")
            return
        self._zero = zero
        self.report_health()
        sentence, passed = zero_sentence(zero), zero.flat_residual_um <= FLAT_RESIDUAL_UM
        self._states.update(sentence=sentence)
        self._states.publish(ZeroChecked(zero.flat_residual_um, passed, sentence))
        show(self._hardware, "good" if passed else "doubtful")

    def seen_code(self) -> str | None:
        """Return the text of the QR code or barcode before the camera; None where none can be read.

        Raises
        ------
        FrameNotConfirmed, HalError
            No frame could be taken.
        """
        return read_code(capture(self._hardware, CaptureSettings.of_board(self._hardware)))

    def change_gel(self, gel_id: str, slab_thickness_mm: float | None = None) -> None:
        """Mount another gel: its calibration becomes active (`Info`), or scans are refused (`Failed`).

        slab_thickness_mm : of a new gel; None: the board profile's
        """
        default = self._hardware.profile.gel
        try:
            self._registry()  # records the active calibration for the gel that is taken off
            known = known_gel(self._store.root, gel_id) if slab_thickness_mm is None else None
            mount_gel(self._store.root, known or make_gel(gel_id, slab_thickness_mm or default.slab_thickness_mm))
            entry = self._registry().switch()
        except DeviceError as error:
            self.prepare()
            self._fail(str(error))
            return
        self.prepare()
        self._states.publish(Info(f"Gel {gel_id} is mounted; calibration {entry.calibration_id} is active."))

    @property
    def plan(self) -> CaptureSettings | None:
        """Exposure and currents of the active calibration; None without one."""
        return self._scanner.plan if self._scanner else None

    def forget_balance(self) -> None:
        """Take the board profile's exposure and currents for the next calibration again: `Info`."""
        try:
            BALANCE.remove(self._store.root)
            self._report_next_light(self.fitted())
        except DeviceError as error:
            self._fail(str(error))
            return
        self._states.update(balance=None)
        self._states.publish(Info("The next calibration uses the board profile's exposure and currents again."))

    def roll_back(self) -> None:
        """Activate the previous calibration: `Info`, or `Failed` without one."""
        try:
            entry = self._registry().roll_back()
        except DeviceError as error:
            self._fail(str(error))
            return
        self.prepare()
        self._states.publish(Info(f"Rolled back to version {entry.version}: {entry.calibration_id} is active."))

    def activate(self, calibration_id: str) -> None:
        """Activate a stored calibration: `Info`, or `Failed` if it is foreign, stale or damaged."""
        try:
            self._registry().activate(calibration_id)
        except DeviceError as error:
            self._fail(str(error))
            return
        self.prepare()
        self._states.publish(Info(f"Calibration {calibration_id} is active."))

    def _report_next_light(self, fitted: Hardware) -> None:
        """Update the light of the next calibration in the state."""
        plan = calibration_settings(fitted, self._store.root)
        is_balanced = plan != CaptureSettings.of_board(fitted)
        self._states.update(next_light=NextLight(plan, is_balanced))

    def _registry(self) -> CalibrationRegistry:
        registry = CalibrationRegistry(self._store, self.fitted().profile)
        registry.active_entry()
        return registry

    def _fail(self, sentence: str) -> None:
        self._states.update(sentence=sentence)
        self._states.publish(Failed(sentence))
        show(self._hardware, "refused: calibration")


def active_selection(store: BundleStore, hardware: Hardware) -> Selection:
    """Return the mounted gel and active calibration as they are on the disk now."""
    gel, active = gel_state(store.root, hardware), b""
    with suppress(OSError):
        active = ACTIVE.path(store.root).read_bytes()
    return gel.gel_id, gel.slab_thickness_mm, active


def calibration_state(
    calibration: CalibrationBundle, registry: CalibrationRegistry, store: BundleStore
) -> CalibrationState:
    """Return the active calibration. Errors as for `CalibrationRegistry.active_entry`."""
    record = calibration.record
    entry = registry.active_entry()
    return CalibrationState(
        calibration_id=record.calibration_id,
        gel_id=record.gel_id,
        version=entry.version if entry else None,
        slot=entry.slot if entry else None,
        age_s=calibration_age_s(calibration, store),
        held_out_deg=record.figures.get("held_out_error_deg"),
        brightness=Brightness.of_figures(record.figures),
    )


def calibration_age_s(calibration: CalibrationBundle, store: BundleStore) -> float | None:
    """Return the age of a calibration by the wall clock; None if negative, when that clock is wrong."""
    age_s = (store.wall_time() - calibration.record.created).total_seconds()
    return age_s if age_s >= 0.0 else None


def gel_state(root: Path, hardware: Hardware) -> GelState:
    """Return the mounted gel; the board's default while the store's record is damaged, which `Scanner` then refuses."""
    default = hardware.profile.gel
    try:
        gel = mounted_gel(root, default)
    except DeviceError:
        return GelState(default.id, default.slab_thickness_mm, 0)
    return GelState(gel.gel_id, gel.slab_thickness_mm, gel.presses)


CODE_BINNING: Final = 2


def read_code(frame: RawFrame) -> str | None:
    """Return the text of the frame's code, also a mirrored one; None where none can be read."""
    grey = bin_bayer(frame, CODE_BINNING).rgb.mean(axis=-1)
    low, high = np.percentile(grey, (1.0, 99.0))
    spread = max(float(high - low), 1e-6)
    shown = (255.0 * np.clip((grey - low) / spread, 0.0, 1.0)).astype(np.uint8)
    for picture in (shown, np.ascontiguousarray(shown[:, ::-1])):
        text = cv2.QRCodeDetector().detectAndDecode(picture)[0]
        text = text or cv2.barcode.BarcodeDetector().detectAndDecode(picture)[0]
        if text and text.isprintable():
            return str(text)
    return None
