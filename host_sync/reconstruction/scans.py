"""Reconstructs the scans of a frame set, and those of a library with the calibration that was active at their press.

Results of a frame set go to DIR/<scan>/, its report to DIR/calibration/. The report's overview picture shows the
reference read as a scan.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Final

import numpy as np

from device.bundles.fingerprint import Fingerprint
from device.bundles.scan import ScanBundle
from device.calibration.acceptance import MAX_PITCH_ERROR
from device.errors import CalibrationMismatch, DeviceError
from device.imaging.flat_field import LinearFrame, make_flat_field
from device.io.atomic import check_replaceable
from hal.frame import AS_GRANTED, BayerOrder
from host_sync.calibration.calibrate import Calibration, Method
from host_sync.calibration_file.calibrator import Calibrator
from host_sync.calibration_file.kept_calibration import KeptCalibration
from host_sync.calibration_report.report import DPI, REPORT_FILE
from host_sync.errors import FrameSetError, HostError
from host_sync.filters.form import DetailBand
from host_sync.frames.frame_set import FrameSet, ScanSpec
from host_sync.frames.frame_set_file import CALIBRATION_FOLDER
from host_sync.frames.linear_light import read_frame
from host_sync.kernels.process_settings import kept_memory
from host_sync.library.library import Library
from host_sync.reconstruction.pipeline import Reconstruction, reconstruct
from host_sync.reconstruction.result_writer import write_result
from host_sync.reconstruction.slope_reading import LightSequence, read_light_sequence
from host_sync.render.picture_file import figure_png
from host_sync.results.doubts import stated_doubts
from host_sync.results.files import OVERVIEW_FILE, DetailName
from host_sync.results.record import FrameCheck, not_checked

NO_REFERENCE = "no frame of untouched skin: nothing shows how flat it is read"


def with_overview(kept: KeptCalibration, reference: LinearFrame | None) -> KeptCalibration:
    """Return the calibration with the overview among the files of its report."""
    from host_sync.calibration_report.overview import overview_figure  # matplotlib takes a while to load

    at_rest, why_not = None, NO_REFERENCE
    if reference is not None:
        try:
            at_rest = reconstruct(reference, kept.calibration, "the reference", force=True).height
        except (DeviceError, HostError) as error:
            why_not = f"the reference cannot be read as a scan: {error}"
    picture = figure_png(overview_figure(kept.calibration, at_rest, why_not), DPI)
    return replace(kept, report=kept.report | {OVERVIEW_FILE: picture})


SAME_REFERENCE: Final = 0.003
"""Difference of two frames' light, as a fraction of it, up to which they are one reference."""

SAME_PIXEL_SHAPE: Final = 0.01


@dataclass(frozen=True, slots=True)
class ScanFailure:
    """A scan that could not be reconstructed, and the sentence that says why."""

    name: str
    reason: str


def chosen_scans(frame_set: FrameSet, names: Sequence[str]) -> list[ScanSpec]:
    """Return the scans of these names, or all when none is named.

    Raises
    ------
    FrameSetError
        The set has no such scan.
    """
    known = {scan.name: scan for scan in frame_set.scans}
    unknown = [name for name in names if name not in known]
    if unknown:
        raise FrameSetError(
            f"{frame_set.path} has no scan {', '.join(unknown)}: name one of {', '.join(known) or '(it has none)'}"
        )
    return [known[name] for name in names] if names else list(frame_set.scans)


@kept_memory()
def reconstruct_frame_set(
    frame_set: FrameSet,
    out: Path,
    method: Method | None = None,
    names: Sequence[str] = (),
    report_progress: Callable[[str], None] = lambda _: None,
    band: DetailBand | None = None,
    *,
    force: bool = False,
    detail: DetailName = "shrunk",
    calibrator: Calibrator | None = None,
) -> tuple[dict[str, tuple[str, ...]], list[ScanFailure]]:
    """Reconstruct the named scans (all when none is named) and write every result: doubts by scan, and failures.

    band : of the detail that is written beside each height map, if any
    force : reconstruct frames too that the calibration cannot explain
    detail : of the height maps
    calibrator : gives the calibration; by default it is made now

    Raises
    ------
    FrameSetError, DeviceError
        There is no calibration to work with.
    OutputError
        Nothing can be written to `out`.
    """
    check_replaceable(out / CALIBRATION_FOLDER, REPORT_FILE)  # before minutes of work
    chosen_scans(frame_set, names)
    kept = (calibrator or Calibrator(report_progress=report_progress)).of_frame_set(frame_set)
    _check_pixels(frame_set, kept)
    scans = chosen_scans(frame_set.scaled_as(kept.facts.full_scale).with_marks(kept.facts.marks_px), names)
    kept.write_report(out / CALIBRATION_FOLDER)
    calibration = kept.calibration
    done: dict[str, tuple[str, ...]] = {}
    failures = []
    for scan in scans:
        report_progress(f"{scan.name}: slopes and height")
        try:
            reconstruction = reconstruct(
                read_frame(scan.frame), calibration, scan.frame.name, method, force=force, detail=detail
            )
            write_result(out / scan.name, reconstruction, calibration, scan.name, {"frame_set": frame_set.name}, band)
        except (DeviceError, HostError) as error:
            failures.append(ScanFailure(scan.name, str(error)))
        else:
            done[scan.name] = stated_doubts(out / scan.name)
    return done, failures


def _check_pixels(frame_set: FrameSet, kept: KeptCalibration) -> None:
    """Refuse a calibration of pixels of another pitch or shape than the frame set states."""
    pitch_um, shape = kept.calibration.pitch_um, kept.facts.pixel_shape
    if abs(frame_set.pixel_pitch_um / pitch_um - 1.0) > MAX_PITCH_ERROR:
        raise FrameSetError(
            f"{frame_set.path}: pixel_pitch_um: {frame_set.pixel_pitch_um:g} is not the calibration's {pitch_um:g}: "
            "use a calibration of this camera mode"
        )
    if abs(frame_set.pixel_shape / shape - 1.0) > SAME_PIXEL_SHAPE:
        raise FrameSetError(
            f"{frame_set.path}: pixel_pitch_um: pixels are {frame_set.pixel_shape:.3g} times as high as wide here, and "
            f"{shape:.3g} times in the calibration: use a calibration of this camera mode"
        )


def has_reference_of(calibration: Calibration, frame_set: FrameSet) -> bool:
    """Return False if a frame set states another reference than that of a calibration."""
    if frame_set.reference is None:
        return True
    stated, own = make_flat_field(read_frame(frame_set.reference)), calibration.flat_field
    return stated.shape == own.shape and bool(np.median(np.abs(stated - own)) < SAME_REFERENCE * np.median(own))


SINGLE_LIGHTS: Final = "shadows seen light by light"


class LibraryReconstructor:
    """Full calibrations are made once a job, however many scans they serve; their reports lie beside their bundles.

    Parameters
    ----------
    library : where scans, calibrations and results lie
    method : the method for every scan; None takes the one that each calibration's held-out balls prefer
    report_progress : is given a few words as each step begins
    band : of the detail that is written beside each height map, if any
    force : reconstruct scans too that their calibration cannot explain
    detail : of the height maps
    calibrator : gives the calibrations; by default each is made now
    """

    def __init__(
        self,
        library: Library,
        method: Method | None = None,
        report_progress: Callable[[str], None] = lambda _: None,
        band: DetailBand | None = None,
        *,
        force: bool = False,
        detail: DetailName = "shrunk",
        calibrator: Calibrator | None = None,
    ) -> None:
        self._library = library
        self._method = method
        self._report_progress = report_progress
        self._band = band
        self._force = force
        self._detail = detail
        self._calibrator = calibrator or Calibrator(report_progress=report_progress)
        self._reported: set[str] = set()

    def run(
        self, scan: ScanBundle, method: Method | None = None, folder: Path | None = None
    ) -> tuple[Reconstruction, Path]:
        """Return the reconstruction of a scan and the folder that its results were written to.

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
        kept = self.calibration_of(scan)
        calibration = kept.calibration
        name = scan.scan_id
        self._report_progress(f"{name[-10:]}: slopes and height")
        chosen = method or self._method
        frame = scan.lit_frame()
        sequence = read_light_sequence(scan)
        reconstruction = reconstruct(
            frame,
            calibration,
            name,
            chosen,
            force=self._force,
            detail=self._detail,
            sequence=None if isinstance(sequence, str) else sequence,
        )
        if checks := _exposure_checks(scan, sequence, uses_single_lights=reconstruction.method == "direct"):
            reconstruction = replace(reconstruction, frame_checks=(*reconstruction.frame_checks, *checks))
        folder = folder or self._library.result_folder(scan, version("retrograph"), calibration.calibration_id)
        self._report_progress(f"{name[-10:]}: results")
        facts = {"scan_id": name, "calibration_bundle": kept.facts.bundle_id, "gel_id": scan.record.gel_id}
        write_result(folder, reconstruction, calibration, name, facts, self._band)
        return reconstruction, folder

    def calibration_of(self, scan: ScanBundle) -> KeptCalibration:
        """Return the calibration of a scan: the one that was named for all, else its own."""
        if self._calibrator.is_named:
            named = self._calibrator.named()
            facts = named.facts
            if facts.gel_id is not None and facts.fingerprint is not None:
                _check_fingerprints(scan, facts.made_from, facts.gel_id, facts.fingerprint)
                _check_orders(scan, facts.channel_order)
            return named
        bundle = self._library.calibration_for(scan)
        _check_fingerprints(scan, bundle.calibration_id, bundle.record.gel_id, bundle.record.fingerprint)
        _check_orders(scan, bundle.reference().bayer_order)
        kept = self._calibrator.of_bundle(bundle)
        if bundle.calibration_id not in self._reported:
            self._reported.add(bundle.calibration_id)
            calibration_id = kept.calibration.calibration_id
            kept.write_report(self._library.result_folder(bundle, version("retrograph"), calibration_id))
        return kept


def _exposure_checks(
    scan: ScanBundle, sequence: LightSequence | str, *, uses_single_lights: bool
) -> tuple[FrameCheck, ...]:
    """Return what was done with the frames of a precise capture."""
    checks = []
    share = scan.record.verdict.figures.get("ambient_share")
    if scan.record.exposures.dark_file is not None and share is not None:
        checks.append(FrameCheck("ambient light taken out", "passed", value=share, unit="of full scale"))
    if isinstance(sequence, str):
        checks += [not_checked(SINGLE_LIGHTS, sequence)] if sequence else []
    elif uses_single_lights:
        checks.append(FrameCheck(SINGLE_LIGHTS, "passed"))
    else:
        checks.append(not_checked(SINGLE_LIGHTS, "the paper's method uses no frames of single lights"))
    return tuple(checks)


def _check_orders(scan: ScanBundle, theirs: BayerOrder | None) -> None:
    """Refuse frames that a kernel turned since the calibration; of a stated order the fingerprints already speak.

    theirs : of the calibration's frames; None of a file that older versions wrote, which does not say
    """
    if theirs is None or scan.record.fingerprint.channel_order != AS_GRANTED:
        return
    if theirs != (ours := scan.raw_frame().bayer_order):
        raise CalibrationMismatch(
            f"scan {scan.scan_id}: the calibration and the frame differ in channel order ({theirs}, not {ours}): "
            "use a calibration made as the scan was"
        )


def _check_fingerprints(scan: ScanBundle, calibration_id: str, gel_id: str, fingerprint: Fingerprint) -> None:
    if scan.record.gel_id != gel_id:
        raise CalibrationMismatch(
            f"scan {scan.scan_id} was taken with gel {scan.record.gel_id} and calibration "
            f"{calibration_id} is of gel {gel_id}: use a calibration of that gel"
        )
    difference = fingerprint.mismatch(scan.record.fingerprint)
    if difference:
        raise CalibrationMismatch(f"scan {scan.scan_id}: {difference}: use a calibration made as the scan was")
