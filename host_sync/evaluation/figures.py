"""The paper's figures of a calibration: reflectance maps, ambiguous bins, errors of a held-out ball."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

from matplotlib.figure import Figure

from device.bundles.calibration import CalibrationBundle
from device.io.atomic import atomic_file
from host_sync.calibration.calibrate import Calibration
from host_sync.calibration.frames import CalibrationFrames, calibrate_frames
from host_sync.calibration_file.inputs import frames_of_bundle, frames_of_set
from host_sync.calibration_report.paper_figures import paper_figures
from host_sync.errors import FrameSetError, LibraryError, ResultError
from host_sync.evaluation.held_out_ball import ball_error_figure, held_out_ball_errors
from host_sync.frames.frame_set import load_frame_set
from host_sync.library.library import Library

DPI: Final = 130


def frames_to_draw(name: str | None, library: Library | None) -> CalibrationFrames:
    """Frames of the frame set at that path, or of a library's calibration, by default the latest.

    Raises
    ------
    FrameSetError, HostError, DeviceError
        The set or calibration does not exist, or a frame is unreadable.
    """
    if library is not None:
        return frames_of_bundle(library.find_calibration(name) if name else _latest(library))
    if name is None:
        raise FrameSetError("name the frame set file: retrosync paper-figures FRAMESET.toml --out DIR")
    return frames_of_set(load_frame_set(Path(name)))


def _latest(library: Library) -> CalibrationBundle:
    bundles = library.calibrations().bundles
    if not bundles:
        raise LibraryError(f"{library.root} holds no calibration: pull one from a device first")
    return bundles[-1]


def write_figures(
    frames: CalibrationFrames,
    out: Path,
    formats: Sequence[str] = ("png",),
    progress: Callable[[str], None] = lambda _: None,
    dpi: int = DPI,
    calibration: Calibration | None = None,
) -> tuple[Path, ...]:
    """Write figures like the paper's 3, 4 and 5 to the folder `out`; returns the files.

    formats : png, pdf or svg
    calibration : of these frames, when it was made before

    Raises
    ------
    CalibrationError, CalibrationMismatch, FrameError
        The frames are not sufficient for a calibration, or show only one ball.
    FrameSetError
        The calibration is of other presses.
    ResultError
        The folder cannot be written.
    """
    if calibration is not None and [one.name for one in calibration.presses] != [one.name for one in frames.presses]:
        raise FrameSetError("the calibration was not made from these frames: name the one that was, or none")
    frames = replace(frames, paper=True)
    calibration = calibration or calibrate_frames(frames, progress)
    figures = paper_figures(calibration.paper_model)
    figures["ball-errors"] = ball_error_figure(held_out_ball_errors(frames, calibration, progress))
    progress("drawing")
    return tuple(_write(figure, out / f"{name}.{kind}", dpi) for name, figure in figures.items() for kind in formats)


def _write(figure: Figure, path: Path, dpi: int) -> Path:
    """Write one picture completely or not at all."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_file(path) as stream:
            figure.savefig(stream, dpi=dpi, format=path.suffix.removeprefix("."))
    except OSError as error:
        raise ResultError(f"{path} cannot be written ({error.strerror or error}): choose another place") from error
    return path
