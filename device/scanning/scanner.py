"""The scanner: one press of the button becomes a published scan, a verdict and a quick look."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from device.bundle_store import BundleStore
from device.calibration_bundle import CalibrationBundle
from device.errors import CalibrationMismatch, DeviceError, StoreError
from device.fingerprint import Fingerprint
from device.model_file import read_model
from device.photometry import bin_bayer
from device.quick_look import QuickLook, QuickLookModel, quick_look
from device.quick_look_files import write_quick_look
from device.raw_file import write_raw
from device.scan_bundle import Annotations, LightFaultRecord, PowerRecord, ScanBundle, ScanRecord, VerdictRecord
from device.scanning.capture import CapturePlan, Shot, take
from device.scanning.scan_health import ScanHealth
from device.settings_record import SettingsRecord
from device.verdict import judge
from hal.hardware import Hardware
from hal.interfaces import PowerReading

BYTES_PER_PIXEL: Final = 2.2
"""A raw frame never needs more room than this, its quick look included."""


@dataclass(frozen=True, slots=True)
class ScanOutcome:
    """A published scan and its quick look; when there is none, `quick_look_fault` says why."""

    bundle: ScanBundle
    quick_look: QuickLook | None
    quick_look_fault: str


@dataclass(frozen=True, slots=True, eq=False)
class TakenPress:
    """A press that was taken and is not yet published.

    shot : its frame, proven
    power : supply and battery right after it
    motion : how much the contact moved as it was taken, in intensity; None when nobody looked
    """

    shot: Shot
    power: PowerReading
    motion: float | None = None


class Scanner:
    """Scans under the active calibration of a store.

    Raises
    ------
    NoCalibration
        None is active.
    CalibrationMismatch
        The active one was made with another board, gel, sensor or place of a light.
    """

    def __init__(self, hardware: Hardware, store: BundleStore) -> None:
        self._hardware = hardware
        self._store = store
        self._calibration = store.active_calibration()
        record = self._calibration.record
        self._plan = CapturePlan.of_calibration(hardware, record.fingerprint, record.asked)
        _check_belongs(self._calibration, hardware, self._plan)
        inverse_map = read_model(self._calibration.path(record.model_files[0]))
        reference = self._calibration.reference()
        self._model = QuickLookModel.prepare(reference, inverse_map, record.pixel_pitch_um)
        self.health = ScanHealth(reference, self._model, hardware.profile, store.root)

    @property
    def calibration(self) -> CalibrationBundle:
        """The calibration that scans are taken under."""
        return self._calibration

    @property
    def plan(self) -> CapturePlan:
        """Exposure and currents of every scan."""
        return self._plan

    @property
    def model(self) -> QuickLookModel:
        """The calibration at quick-look size."""
        return self._model

    def scans_left(self) -> int:
        """How many more scans fit.

        Raises
        ------
        StoreError
            The disk cannot be asked.
        """
        return self._store.scans_left(self._bytes_per_scan)

    def check_room(self) -> int:
        """How many more scans fit; when none does, scans that a workstation vouches for make room, oldest first.

        Raises
        ------
        StoreError
            Not one more fits: the press is refused before it is made.
        """
        left = self.scans_left()
        if left < 1 and self._store.make_room(self._bytes_per_scan):
            left = self.scans_left()
        if left < 1:
            raise StoreError(f"{self._store.root} has no room for another scan: offload scans or free space first")
        return left

    @property
    def _bytes_per_scan(self) -> int:
        rows, columns = self._hardware.camera.shape
        return int(BYTES_PER_PIXEL * rows * columns)

    def scan(self, annotations: Annotations, may_lift: Callable[[], None] = lambda: None) -> ScanOutcome:
        """Capture, judge, look and publish; `may_lift` is called as soon as the frame is in memory.

        Raises
        ------
        StoreError, FrameNotProven, HalError
            As for `take` and `publish`.
        """
        return self.publish(self.take(may_lift), annotations)

    def take(self, may_lift: Callable[[], None] = lambda: None) -> TakenPress:
        """One press in memory; nothing is kept of it unless it is published.

        Raises
        ------
        StoreError
            There is no room for it.
        FrameNotProven, HalError
            No frame could be taken.
        """
        self.check_room()
        shot = take(self._hardware, self._plan)
        may_lift()
        return TakenPress(shot, self._hardware.power.read())

    def publish(self, press: TakenPress, annotations: Annotations) -> ScanOutcome:
        """Judge a press, look at it and publish it.

        Raises
        ------
        StoreError
            The disk is full; nothing is left behind.
        """
        frame = press.shot.frame
        binned = bin_bayer(frame, self._model.binning)
        look, fault = None, ""
        try:
            look = quick_look(binned, self._model)
        except DeviceError as error:
            fault = str(error)
        intensity = look.intensity if look else None
        flags = {fault.light: fault.kind for fault in press.shot.light_faults or ()}
        known = self.health.circumstances(intensity, look, press.motion)
        verdict = judge(binned, intensity, self._hardware.lights.names, flags, known)
        record = self._record(press, annotations, verdict)

        def write(directory: Path) -> None:
            write_raw(directory / record.raw_file, frame)
            if look:
                write_quick_look(directory, look.height)

        return ScanOutcome(self._store.publish_scan(record, write), look, fault)

    def _record(self, press: TakenPress, annotations: Annotations, verdict: VerdictRecord) -> ScanRecord:
        profile, frame, faults = self._hardware.profile, press.shot.frame, press.shot.light_faults
        currents_ma = dict(self._plan.currents_ma)
        return ScanRecord(
            identity=self._store.next_identity("scans"),
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
            verdict=verdict,
            annotations=annotations,
            # Read again after the quick look, the heaviest work of a scan: a supply that sags does it in one of them.
            power=PowerRecord.of(self._hardware.power.read().with_earlier(press.power)),
            light_faults=None
            if faults is None
            else tuple(LightFaultRecord(light=f.light, kind=f.kind) for f in faults),
        )


def _check_belongs(calibration: CalibrationBundle, hardware: Hardware, plan: CapturePlan) -> None:
    """Refuse a calibration of another board, gel or size, or with a light elsewhere."""
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
    sentence = f"they differ in {'; '.join(differences)}" if differences else record.fingerprint.mismatch(present)
    if sentence:
        raise CalibrationMismatch(
            f"calibration {record.calibration_id} is not of this instrument as it is now: {sentence}; "
            "run `retroscan calibrate`"
        )
