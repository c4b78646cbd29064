"""Calibrates from a frame set and reconstructs its scans: results to DIR/<scan>/, the report to DIR/calibration/."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from device.errors import DeviceError
from device.io.atomic import check_replaceable
from host_sync.calibration.balls import GridSpacing, PressFrame
from host_sync.calibration.calibrate import Calibration, Method
from host_sync.calibration.frames import CalibrationFrames, calibrate_frames
from host_sync.calibration_report.report import REPORT_FILE, write_report
from host_sync.errors import FrameSetError, HostError
from host_sync.filters.detail import DetailBand
from host_sync.frames.frame_set import FrameSet, PressSpec, ScanSpec
from host_sync.frames.linear_light import read_frame
from host_sync.reconstruction.pipeline import reconstruct
from host_sync.reconstruction.result_writer import write_result
from host_sync.results.detail_name import DetailName

CALIBRATION_FOLDER = "calibration"
NO_REFERENCE_FRAMES = 24
"""At most so many frames stand in for a missing reference."""


@dataclass(frozen=True, slots=True)
class ScanFailure:
    """A scan that could not be reconstructed, and the sentence that says why."""

    name: str
    reason: str


def calibrate_frame_set(frame_set: FrameSet, tell: Callable[[str], None] = lambda _: None) -> Calibration:
    """The calibration that a frame set's presses carry.

    Raises
    ------
    FrameSetError, DeviceError
        A frame is unreadable, or the presses do not carry a calibration.
    """
    tell("reading frames")
    return calibrate_frames(frames_of_set(frame_set), tell)


def frames_of_set(frame_set: FrameSet) -> CalibrationFrames:
    """The frames that a frame set's calibration is made from.

    Raises
    ------
    FrameSetError
        A frame is unreadable.
    """
    presses = tuple(_press_frame(press, frame_set.path.parent) for press in frame_set.presses)
    reference = read_frame(frame_set.reference) if frame_set.reference else None
    others = () if reference else tuple(read_frame(scan.frame) for scan in frame_set.scans[:NO_REFERENCE_FRAMES])
    return CalibrationFrames(presses, reference, frame_set.pixel_pitch_um, others)


def _press_frame(press: PressSpec, folder: Path) -> PressFrame:
    """The press as calibration takes it; its file is named as seen from the frame set's folder."""
    image = press.frame.images[0]
    tolerance = press.radius_tolerance_mm
    return PressFrame(
        name=press.name,
        frame=read_frame(press.frame),
        radius_px=press.radius_px,
        balls=press.balls,
        labelled_by_hand=press.balls is not None,
        source=str(image.relative_to(folder)) if image.is_relative_to(folder) else image.name,
        grid=GridSpacing(press.grid_pitch_mm, press.grid_tolerance_mm) if press.grid_pitch_mm else None,
        radius_tolerance=tolerance / press.ball_radius_mm if tolerance is not None else None,
    )


def chosen_scans(frame_set: FrameSet, names: Sequence[str]) -> list[ScanSpec]:
    """The scans of these names, or all when none is named.

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
    calibrated: Callable[[Calibration], None] = lambda _: None,
) -> tuple[dict[str, tuple[str, ...]], list[ScanFailure]]:
    """Reconstruct the named scans (all when none is named) and write every result: warnings by scan, and failures.

    band : of the detail that is written beside each height map, if any
    force : reconstruct frames too that the calibration cannot explain
    detail : of the height maps
    calibrated : is given the calibration as soon as it is made

    Raises
    ------
    FrameSetError, DeviceError
        There is no calibration to work with.
    OutputError
        Nothing can be written to `out`.
    """
    scans = chosen_scans(frame_set, names)
    check_replaceable(out / CALIBRATION_FOLDER, REPORT_FILE)  # before minutes of work
    calibration = calibrate_frame_set(frame_set, tell)
    write_report(out / CALIBRATION_FOLDER, calibration)
    calibrated(calibration)
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
            done[scan.name] = reconstruction.warnings
    return done, failures
