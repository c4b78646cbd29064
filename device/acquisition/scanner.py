"""The scanner: a button press becomes a published scan with a verdict and a quick look."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from device.acquisition.capture import CaptureSettings, capture_with_faults
from device.acquisition.check_press import measure_check
from device.acquisition.precise_capture import (
    PreciseCapture,
    capture_precisely,
    exposures_record,
    frames_stored,
    with_ambient_share,
)
from device.acquisition.scan_health import ScanHealth
from device.bundles.calibration import CalibrationBundle
from device.bundles.check import CHECK_FILE, CheckRecord, CheckStandard, last_of_standards
from device.bundles.fingerprint import Fingerprint, SettingsRecord
from device.bundles.raw_frame import write_raw
from device.bundles.record import Identity, encode_record
from device.bundles.scan import (
    Annotations,
    CaptureMode,
    LightFaultRecord,
    PowerRecord,
    Retake,
    ScanBundle,
    ScanRecord,
    VerdictRecord,
)
from device.errors import CalibrationMismatch, DeviceError, StoreError
from device.imaging.flat_field import bin_bayer
from device.imaging.frame_light import Levels, without_ambient
from device.inverse_map.model import read_model
from device.quality.verdict import Evidence
from device.quick_look.solver import REST_FILE, QuickLook, QuickLookModel, quick_look, read_rest, write_quick_look
from device.store.checks import judged_check, read_checks, write_check
from device.store.store import BundleStore
from hal.frame import RawFrame
from hal.hardware import Hardware
from hal.interfaces import PowerReading

BYTES_PER_PIXEL: Final = 2.2
"""Upper bound for a scan's size on disk per pixel, quick look included."""

LIFT_PATIENCE_S: Final = 10.0
"""Time after a press in which the operator may lift so that the lights are checked on untouched skin."""

LOOK_AGAIN_S: Final = 0.2


@dataclass(frozen=True, slots=True)
class ScanOutcome:
    """A published scan and its quick look; without one, `quick_look_fault` says why."""

    bundle: ScanBundle
    quick_look: QuickLook | None
    quick_look_fault: str


@dataclass(frozen=True, slots=True, eq=False)
class Assessment:
    """A press with its quick look and the evidence for its verdict, not published yet.

    press : with its confirmed frame
    quick_look, fault : None without a quick look; `fault` then says why
    evidence : what the verdict follows from
    """

    press: RawCapture
    quick_look: QuickLook | None
    fault: str
    evidence: Evidence

    @property
    def awaits_lift(self) -> bool:
        """True if the press is good if the lights prove right: its frame shows too little untouched skin to decide."""
        return self.evidence.lacks_only_lights


@dataclass(frozen=True, slots=True, eq=False)
class RawCapture:
    """A captured press that is not published yet.

    precise : its confirmed frame, and those under other lights if taken
    power : supply and battery right after it
    motion : of the contact during the exposure, in intensity; None if not measured
    """

    precise: PreciseCapture
    power: PowerReading
    motion: float | None = None

    @property
    def frame(self) -> RawFrame:
        """The frame that is stored."""
        return self.precise.capture.frame

    @property
    def lit(self) -> RawFrame:
        """The frame without ambient light, if that was measured."""
        dark = self.precise.dark
        return self.frame if dark is None else without_ambient(self.frame, dark)


class Scanner:
    """Scans with the active calibration of a store.

    Raises
    ------
    NoCalibration
        No calibration is active.
    CalibrationMismatch
        The active one was made with another board, gel, sensor or light position.
    """

    def __init__(self, hardware: Hardware, store: BundleStore) -> None:
        self._hardware = hardware
        self._store = store
        self._calibration = store.active_calibration()
        record = self._calibration.record
        self._plan = CaptureSettings.of_calibration(hardware, record.fingerprint, record.asked)
        _check_matches(self._calibration, hardware, self._plan)
        inverse_map = read_model(self._calibration.path(record.model_files[0]))
        reference = self._calibration.reference()
        self._plan = replace(self._plan, bayer_order=reference.bayer_order)
        rest = read_rest(self._calibration.path(REST_FILE)) if REST_FILE in record.model_files else None
        self._model = QuickLookModel.prepare(
            reference, inverse_map, record.pixel_pitch_um, rest, record.figures.get("held_out_error_deg")
        )
        self.health = ScanHealth(reference, self._model, hardware.profile, store.root)

    @property
    def calibration(self) -> CalibrationBundle:
        """The calibration that scans use."""
        return self._calibration

    @property
    def plan(self) -> CaptureSettings:
        """Exposure and currents of every scan."""
        return self._plan

    @property
    def model(self) -> QuickLookModel:
        """The calibration at quick-look size."""
        return self._model

    def scans_left(self, mode: CaptureMode = "single") -> int:
        """Return the number of scans of this mode that still fit on the disk.

        Raises
        ------
        StoreError
            The free space cannot be read.
        """
        return self._store.scans_left(self._bytes_per_scan(mode))

    def scans_promised(self, mode: CaptureMode = "single") -> int:
        """Return the number of scans that fit now or, if none, once a press has made room; nothing is removed.

        Raises
        ------
        StoreError
            The store cannot be read.
        """
        return self.scans_left(mode) or self._store.scans_left_after_removal(self._bytes_per_scan(mode))

    def check_room(self, mode: CaptureMode = "single") -> int:
        """Return the number of scans that still fit; if none, room is made as `BundleStore.make_room` does.

        Raises
        ------
        StoreError
            Not one more fits: the press is refused before the exposure.
        """
        left = self.scans_left(mode)
        if left < 1:
            self._store.make_room(self._bytes_per_scan(mode))
            left = self.scans_left(mode)
        if left < 1:
            raise StoreError(f"{self._store.root} has no room for another scan: offload scans or free space")
        return left

    def _bytes_per_scan(self, mode: CaptureMode) -> int:
        rows, columns = self._hardware.camera.shape
        return int(BYTES_PER_PIXEL * rows * columns) * frames_stored(mode, len(self._hardware.lights.names))

    def scan(
        self, annotations: Annotations, may_lift: Callable[[], None] = lambda: None, mode: CaptureMode = "single"
    ) -> ScanOutcome:
        """Capture, judge and publish; `may_lift` is called as soon as the frame is in memory.

        The operator should lift then: if the frame alone cannot prove the lights right, untouched skin does.

        Raises
        ------
        StoreError, FrameNotConfirmed, HalError
            As for `check_room`, `capture` and `publish`.
        """
        self.check_room(mode)
        assessed = self.assess(self.capture(may_lift, mode))
        if assessed.awaits_lift:
            self._look_at_untouched_skin()
        return self.publish(assessed, annotations)

    def measure_lights(self) -> bool:
        """Measure each light alone on untouched skin; returns whether that worked: nothing may touch the gel.

        Of lights that are always on, each is taken to make its own channel alone.

        Raises
        ------
        FrameNotConfirmed, HalError
            A frame could not be taken.
        """
        if self._hardware.profile.lights_always_on:
            self.health.take_channels_for_lights()
            return True
        currents_ma = self._plan.currents_ma
        alone = [self._frame_under({name: currents_ma[name]}) for name in self._hardware.lights.names]
        return self.health.measure_shares(alone, self._frame_under({}))

    def capture(self, may_lift: Callable[[], None] = lambda: None, mode: CaptureMode = "single") -> RawCapture:
        """Capture one press into memory; nothing is stored before `publish`, for which `check_room` makes room.

        Raises
        ------
        FrameNotConfirmed, HalError
            No frame could be taken.
        """
        captured = capture_precisely(self._hardware, self._plan, mode, self.health.measure_press)
        may_lift()
        return RawCapture(captured, self._hardware.power.read())

    def assess(self, press: RawCapture) -> Assessment:
        """Return the quick look of a press and the evidence for its verdict."""
        lit = press.lit
        binned = bin_bayer(lit, self._model.binning)
        look, fault = None, ""
        try:
            look = quick_look(binned, self._model)
        except DeviceError as error:
            fault = str(error)
        intensity = look.intensity if look else None
        flags = {fault.light: fault.kind for fault in press.precise.capture.light_faults or ()}
        known = self.health.context_of_scan(lit, intensity, press.motion)
        evidence = Evidence.of(binned, intensity, self._hardware.lights.names, flags, known)
        return Assessment(press, look, fault, evidence)

    def lights_proven(self, assessed: Assessment) -> bool:
        """Return whether the lights were measured on untouched skin since a press."""
        changes = self.health.light_change_since(assessed.press.frame.sensor_timestamp_ns)
        return None not in changes.values()

    def publish(
        self,
        assessed: Assessment,
        annotations: Annotations,
        standard: CheckStandard | None = None,
        retake: Retake | None = None,
        *,
        asks: bool = False,
    ) -> ScanOutcome:
        """Judge an assessed press, with the lights as measured since where its frame did not show them, and publish it.

        standard : the check standard that was pressed, if one was
        retake : the scan that was taken again, if one was; the record names it if this one replaces it
        asks : whether an operator can be asked about a ball that looks like another standard

        Raises
        ------
        StoreError
            The disk is full; nothing is left behind.
        CheckNotMeasured, BallInDoubt
            The press does not show the check standard, or a look-alike to ask about; nothing is stored.
        """
        frame, evidence, look = assessed.press.frame, assessed.evidence, assessed.quick_look
        if assessed.awaits_lift:
            evidence = evidence.with_light_change(self.health.light_change_since(frame.sensor_timestamp_ns))
        press = assessed.press
        levels = self._levels(evidence)
        seen = (look, evidence, press.lit, self._model, levels, self._calibration)
        measured = measure_check(standard, *seen, asks=asks) if standard else None
        identity = self._store.next_identity("scans")
        check = self.last_check()
        if standard and measured:
            calibration_id, now = self._calibration.calibration_id, self._store.wall_time()
            check = judged_check(self._store.root, standard, identity, calibration_id, now, measured)
            # Before the scan: a power cut between the two may cost the scan, but never a failed check.
            write_check(self._store.root, check)
        last = self.last_check()
        if last is not None and not last.passed:
            evidence = evidence.with_failed_check(last.sentence)
        verdict = evidence.verdict()
        replaces = retake.scan_id if retake and retake.is_replaced_by(verdict.level) else None
        record = self._record(press, annotations, verdict, identity, check, replaces)
        exposures, beside = record.exposures, press.precise

        def write(directory: Path) -> None:
            write_raw(directory / record.raw_file, frame)
            if check is not None and check.scan_id == record.scan_id:
                (directory / CHECK_FILE).write_bytes(encode_record(check))
            if exposures.dark_file and beside.dark:
                write_raw(directory / exposures.dark_file, beside.dark)
            for light, name in exposures.alone_files.items():
                write_raw(directory / name, beside.alone[light])
            if record.movie and beside.movie:
                for name, one in zip(record.movie.files, beside.movie.frames, strict=True):
                    write_raw(directory / name, one)
            if look:
                write_quick_look(directory, look.height)

        return ScanOutcome(self._store.publish_scan(record, write), look, assessed.fault)

    def last_check(self) -> CheckRecord | None:
        """Return the last check with this calibration; of several standards one whose last check failed."""
        mine = (one for one in read_checks(self._store.root) if one.calibration_id == self._calibration.calibration_id)
        return last_of_standards(mine)

    def _levels(self, evidence: Evidence) -> Levels:
        """Return the intensity of untouched skin in R, G and B at a press: as measured, or as its border shows it."""
        changes = evidence.known.light_change
        if None not in changes.values() or evidence.border is None:
            return self.health.channel_levels
        return evidence.border

    def _look_at_untouched_skin(self) -> None:
        """Measure the lights once the operator has lifted, within `LIFT_PATIENCE_S`."""
        clock = self._hardware.clock
        until_ns = clock.monotonic_ns() + round(LIFT_PATIENCE_S * 1e9)
        while clock.monotonic_ns() < until_ns:
            if not self.health.knows_shares:
                self.measure_lights()
            if self.health.update(self._frame_under(self._plan.currents_ma)):
                return
            clock.sleep(LOOK_AGAIN_S)

    def _frame_under(self, currents_ma: Mapping[str, float]) -> RawFrame:
        return capture_with_faults(self._hardware, replace(self._plan, currents_ma=currents_ma)).frame

    def _record(
        self,
        press: RawCapture,
        annotations: Annotations,
        verdict: VerdictRecord,
        identity: Identity,
        check: CheckRecord | None,
        replaces: str | None,
    ) -> ScanRecord:
        profile, frame, faults = self._hardware.profile, press.frame, press.precise.capture.light_faults
        currents_ma = dict(self._plan.currents_ma)
        return ScanRecord(
            identity=identity,
            check=check,
            replaces=replaces,
            wall_time=self._store.wall_time(),
            board=profile.name,
            pixel_pitch_um=profile.sensor.pixel_pitch_um,
            shape=frame.shape,
            gel_id=profile.gel.id,
            asked=SettingsRecord.of(self._plan.settings),
            granted=SettingsRecord.of(frame.granted),
            currents_ma=currents_ma,
            fingerprint=Fingerprint.of(profile, frame.granted, currents_ma),
            calibration_id=self._calibration.calibration_id,
            verdict=with_ambient_share(verdict, press.precise),
            exposures=exposures_record(press.precise),
            movie=press.precise.movie.record() if press.precise.movie else None,
            annotations=annotations,
            # Read again after the quick look, the heaviest work of a scan, during which a weak supply sags.
            power=PowerRecord.of(self._hardware.power.read().with_earlier(press.power)),
            light_faults=None
            if faults is None
            else tuple(LightFaultRecord(light=f.light, kind=f.kind) for f in faults),
        )


def _check_matches(calibration: CalibrationBundle, hardware: Hardware, plan: CaptureSettings) -> None:
    """Refuse a calibration of another board, gel or frame size, or with a light at another position."""
    record, profile = calibration.record, hardware.profile
    differences = [
        f"{what} ({mine}, not {theirs})"
        for what, mine, theirs in (
            ("board", record.board, profile.name),
            ("gel", record.gel_id, profile.gel.id),
            ("frame size", record.shape, hardware.camera.shape),
        )
        if mine != theirs
    ]
    present = Fingerprint.of(profile, plan.granted or plan.settings, plan.currents_ma)
    sentence = f"different {'; '.join(differences)}" if differences else record.fingerprint.mismatch(present)
    if sentence:
        raise CalibrationMismatch(
            f"calibration {record.calibration_id} does not match this instrument: {sentence}; run `retroscan calibrate`"
        )
