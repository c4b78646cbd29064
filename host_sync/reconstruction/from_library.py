"""Reconstructs scans of a library, each with the calibration that was active at its press."""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path

from device.bundles.calibration import CalibrationBundle
from device.bundles.scan import ScanBundle
from device.errors import CalibrationMismatch
from device.imaging.flat_field import demosaic
from host_sync.calibration.balls import PressFrame
from host_sync.calibration.calibrate import Calibration, Method
from host_sync.calibration.frames import CalibrationFrames, calibrate_frames
from host_sync.calibration_report.report import write_report
from host_sync.filters.detail import DetailBand
from host_sync.library.library import Library
from host_sync.reconstruction.pipeline import Reconstruction, reconstruct_raw
from host_sync.reconstruction.result_writer import write_result
from host_sync.results.detail_name import DetailName


class LibraryReconstructor:
    """Full calibrations are made once a job, however many scans they serve; their reports lie beside their bundles.

    Parameters
    ----------
    library : where scans, calibrations and results lie
    method : the method for every scan; None takes the one that each calibration's held-out balls prefer
    tell : is given a few words as each step begins
    band : of the detail that is written beside each height map, if any
    force : reconstruct scans too that their calibration cannot explain
    detail : of the height maps
    calibrated : is given every calibration as soon as it is made
    """

    def __init__(
        self,
        library: Library,
        method: Method | None = None,
        tell: Callable[[str], None] = lambda _: None,
        band: DetailBand | None = None,
        *,
        force: bool = False,
        detail: DetailName = "shrunk",
        calibrated: Callable[[Calibration], None] = lambda _: None,
    ) -> None:
        self._library = library
        self._method = method
        self._tell = tell
        self._band = band
        self._force = force
        self._detail = detail
        self._calibrated = calibrated
        self._calibrations: dict[str, Calibration] = {}

    def run(
        self, scan: ScanBundle, method: Method | None = None, folder: Path | None = None
    ) -> tuple[Reconstruction, Path]:
        """The reconstruction of a scan and the folder that its results were written to.

        method : another than the job's
        folder : another place than the one beside the scan

        Raises
        ------
        RecordError
            The scan or its calibration is damaged.
        MissingCalibration
            The library does not hold it.
        CalibrationMismatch
            They were taken with other lights, sizes or settings.
        """
        bundle = self._library.calibration_for(scan)
        _check_fingerprints(scan, bundle)
        calibration = self._calibration(bundle)
        name = scan.scan_id
        self._tell(f"{name[-10:]}: slopes and height")
        chosen = method or self._method
        reconstruction = reconstruct_raw(
            scan.raw_frame(), calibration, name, chosen, force=self._force, detail=self._detail
        )
        folder = folder or self._library.result_folder(scan, version("retrograph"), calibration.calibration_id)
        self._tell(f"{name[-10:]}: results")
        facts = {"scan_id": name, "calibration_bundle": bundle.calibration_id, "gel_id": scan.record.gel_id}
        write_result(folder, reconstruction, calibration, name, facts, self._band)
        return reconstruction, folder

    def _calibration(self, bundle: CalibrationBundle) -> Calibration:
        known = self._calibrations.get(bundle.calibration_id)
        if known is None:
            known = self._calibrations[bundle.calibration_id] = calibration_of(bundle, self._tell)
            self._tell(f"{bundle.calibration_id[-10:]}: calibration report")
            write_report(self._library.result_folder(bundle, version("retrograph"), known.calibration_id), known)
            self._calibrated(known)
        return known


def calibration_of(bundle: CalibrationBundle, tell: Callable[[str], None] = lambda _: None) -> Calibration:
    """The full calibration from the frames of a bundle and the balls that the device found in them.

    Raises
    ------
    RecordError
        A frame is damaged.
    CalibrationError
        The frames do not carry a calibration.
    """
    return calibrate_frames(frames_of_bundle(bundle), tell)


def frames_of_bundle(bundle: CalibrationBundle) -> CalibrationFrames:
    """The frames of a calibration bundle, with the balls that the device found in them.

    Raises
    ------
    RecordError
        A frame is damaged.
    """
    record = bundle.record
    presses = tuple(
        PressFrame(
            name=press.file,
            frame=demosaic(bundle.press_frame(press)),
            radius_px=press.ball_radius_mm * 1e3 / record.pixel_pitch_um,
            balls=tuple(ball.ball for ball in press.balls),
        )
        for press in record.presses
        if press.balls
    )
    return CalibrationFrames(presses, demosaic(bundle.reference()), record.pixel_pitch_um)


def _check_fingerprints(scan: ScanBundle, calibration: CalibrationBundle) -> None:
    if scan.record.gel_id != calibration.record.gel_id:
        raise CalibrationMismatch(
            f"scan {scan.scan_id} was taken with gel {scan.record.gel_id} and calibration "
            f"{calibration.calibration_id} is of gel {calibration.record.gel_id}: use a calibration of that gel"
        )
    difference = calibration.record.fingerprint.mismatch(scan.record.fingerprint)
    if difference:
        raise CalibrationMismatch(f"scan {scan.scan_id}: {difference}: use a calibration made as the scan was")
