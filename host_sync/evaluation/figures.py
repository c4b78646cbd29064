"""The paper's figures of a calibration: reflectance maps, ambiguous bins, errors of a held-out ball."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

from matplotlib.figure import Figure

from device.bundles.calibration import CalibrationBundle
from device.io.atomic import atomic_file
from host_sync.calibration.calibrate import Calibration
from host_sync.calibration.frames import CalibrationFrames
from host_sync.calibration_file.calibrator import Calibrator
from host_sync.calibration_file.inputs import frames_of_bundle, frames_of_set
from host_sync.calibration_report.paper_figures import paper_figures
from host_sync.errors import FrameSetError, LibraryError, ResultError
from host_sync.evaluation.held_out_ball import ball_error_figure, held_out_ball_errors
from host_sync.frames.frame_set import load_frame_set
from host_sync.library.library import Library

DPI: Final = 130


def frames_to_draw(
    name: str | None, library: Library | None, calibrator: Calibrator
) -> tuple[CalibrationFrames, Calibration]:
    """Frames of the frame set at that path, or of a library's calibration (the latest), and the calibration they carry.

    Raises
    ------
    FrameSetError, HostError, DeviceError
        The set or calibration does not exist, a frame is unreadable, or the frames do not carry a calibration.
    """
    if library is not None:
        bundle = library.find_calibration(name) if name else _latest(library)
        return frames_of_bundle(bundle), calibrator.of_bundle(bundle).calibration
    if name is None:
        raise FrameSetError("name the frame set file: retrosync paper-figures FRAMESET.toml --out DIR")
    frame_set = load_frame_set(Path(name))
    return frames_of_set(frame_set), calibrator.of_frame_set(frame_set).calibration


def _latest(library: Library) -> CalibrationBundle:
    bundles = library.calibrations().bundles
    if not bundles:
        raise LibraryError(f"{library.root} holds no calibration: pull one from a device first")
    return bundles[-1]


def write_figures(
    frames: CalibrationFrames,
    calibration: Calibration,
    out: Path,
    formats: Sequence[str] = ("png",),
    progress: Callable[[str], None] = lambda _: None,
    dpi: int = DPI,
) -> tuple[Path, ...]:
    """Write figures like the paper's 3, 4 and 5 to the folder `out`; returns the files.

    calibration : made from these frames, with the paper's model
    formats : png, pdf or svg

    Raises
    ------
    CalibrationError
        The frames show only one ball.
    FrameSetError
        The calibration is of other presses.
    ResultError
        The folder cannot be written.
    """
    if [one.name for one in calibration.presses] != [one.name for one in frames.presses]:
        raise FrameSetError("the calibration was not made from these frames: name the one that was, or none")
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
