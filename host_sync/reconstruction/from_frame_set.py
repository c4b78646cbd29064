"""Calibrates from a frame set and reconstructs its scans: results to DIR/<scan>/, the report to DIR/calibration/."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from device.calibration.acceptance import PITCH_GROSS_SHARE
from device.errors import DeviceError
from device.io.atomic import check_replaceable
from host_sync.calibration.calibrate import Method
from host_sync.calibration_file.calibrator import Calibrator
from host_sync.calibration_file.kept_calibration import KeptCalibration
from host_sync.calibration_report.report import REPORT_FILE
from host_sync.errors import FrameSetError, HostError
from host_sync.filters.form import DetailBand
from host_sync.frames.frame_set import FrameSet, ScanSpec
from host_sync.frames.linear_light import read_frame
from host_sync.kernels.kept_memory import kept_memory
from host_sync.reconstruction.pipeline import reconstruct
from host_sync.reconstruction.result_writer import write_result
from host_sync.results.doubts import stated_doubts
from host_sync.results.files import DetailName

CALIBRATION_FOLDER = "calibration"
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
    tell: Callable[[str], None] = lambda _: None,
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
    kept = (calibrator or Calibrator(tell=tell)).of_frame_set(frame_set)
    _check_pixels(frame_set, kept)
    scans = chosen_scans(frame_set.scaled_as(kept.facts.full_scale).with_marks(kept.facts.marks_px), names)
    kept.write_report(out / CALIBRATION_FOLDER)
    calibration = kept.calibration
    done: dict[str, tuple[str, ...]] = {}
    failures = []
    for scan in scans:
        tell(f"{scan.name}: slopes and height")
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
    if abs(frame_set.pixel_pitch_um / pitch_um - 1.0) > PITCH_GROSS_SHARE:
        raise FrameSetError(
            f"{frame_set.path}: pixel_pitch_um: {frame_set.pixel_pitch_um:g} is not the calibration's {pitch_um:g}: "
            "use a calibration of this camera mode"
        )
    if abs(frame_set.pixel_shape / shape - 1.0) > SAME_PIXEL_SHAPE:
        raise FrameSetError(
            f"{frame_set.path}: pixel_pitch_um: pixels are {frame_set.pixel_shape:.3g} times as high as wide here, and "
            f"{shape:.3g} times in the calibration: use a calibration of this camera mode"
        )
