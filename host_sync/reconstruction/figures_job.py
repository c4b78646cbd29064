"""The paper's figures of a calibration: reflectance maps, ambiguous bins, errors of a held-out ball."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

from matplotlib.figure import Figure

from device.calibration_bundle import CalibrationBundle
from host_sync.calibration.calibration_frames import CalibrationFrames, calibrate_frames
from host_sync.calibration.figures import paper_figures
from host_sync.errors import FrameSetError, LibraryError, ResultError
from host_sync.frame_set import load_frame_set
from host_sync.library import Library
from host_sync.picture_format import PictureFormat
from host_sync.reconstruction.frame_set_job import frames_of_set
from host_sync.reconstruction.held_out_ball import held_out_ball_errors
from host_sync.reconstruction.library_job import frames_of_bundle
from host_sync.render.ball_error_figure import ball_error_figure

DPI: Final = 130


def frames_to_draw(name: str | None, library: Library | None) -> CalibrationFrames:
    """The frames of the frame set at that path, or of a library's calibration, the latest when none is named.

    Raises
    ------
    FrameSetError, HostError, DeviceError
        There is no such set or calibration, or a frame of it is unreadable.
    """
    if library is not None:
        return frames_of_bundle(library.find_calibration(name) if name else _latest(library))
    if name is None:
        raise FrameSetError("name the frame set's file: retrosync figures FRAMESET.toml --out DIR")
    return frames_of_set(load_frame_set(Path(name)))


def _latest(library: Library) -> CalibrationBundle:
    bundles = library.calibrations().bundles
    if not bundles:
        raise LibraryError(f"{library.root} holds no calibration: pull one from a device first")
    return bundles[-1]


def write_figures(
    frames: CalibrationFrames,
    out: Path,
    formats: Sequence[PictureFormat] = ("png",),
    tell: Callable[[str], None] = lambda _: None,
    dpi: int = DPI,
) -> tuple[Path, ...]:
    """The files written to the folder `out`: figures like the paper's 3, 4 and 5, in each format.

    Raises
    ------
    CalibrationError, CalibrationMismatch, FrameError
        The frames carry no calibration, or show one ball only.
    ResultError
        The folder cannot be written.
    """
    calibration = calibrate_frames(frames, tell)
    figures = paper_figures(calibration.paper)
    figures["ball-errors"] = ball_error_figure(held_out_ball_errors(frames, calibration, tell))
    tell("drawing")
    return tuple(_write(figure, out / f"{name}.{kind}", dpi) for name, figure in figures.items() for kind in formats)


def _write(figure: Figure, path: Path, dpi: int) -> Path:
    """Write one picture whole or not at all."""
    partial = path.with_name(f".{path.name}.partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(partial, dpi=dpi, format=path.suffix.removeprefix("."))
        partial.replace(path)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise ResultError(f"{path} cannot be written ({error.strerror or error}): free or choose another") from error
    return path
