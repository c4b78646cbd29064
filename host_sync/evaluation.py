"""The paper's figures of a calibration: reflectance maps, ambiguous bins, errors of a held-out ball."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from device.balls.sphere import Ball, Viewpoint, sphere_slopes
from device.bundles.calibration import CalibrationBundle
from device.errors import CalibrationError
from device.io.atomic import atomic_file
from device.surface import Float32Array, GradientField, HeightMap, MaskArray
from host_sync.calibration.calibrate import METHODS, Calibration, Method
from host_sync.calibration.frames import CalibrationFrames, calibrate_frames
from host_sync.calibration_file.calibrator import Calibrator
from host_sync.calibration_file.inputs import frames_of_bundle, frames_of_set
from host_sync.calibration_report.paper_figures import caption, paper_figures
from host_sync.errors import FrameSetError, LibraryError, ResultError
from host_sync.frames.frame_set import load_frame_set
from host_sync.library.library import Library
from host_sync.reconstruction.pipeline import reconstruct
from host_sync.reconstruction.slope_reading import seen_slopes

DPI: Final = 130


def frames_to_draw(
    name: str | None, library: Library | None, calibrator: Calibrator
) -> tuple[CalibrationFrames, Calibration]:
    """Return the frames of a frame set or of a library's calibration, and the calibration they carry.

    name : path of the frame set, or id of the library's calibration; None is its latest one

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


# Errors of a held-out ball, by each method, and their figure (paper, section 6 and Fig. 5).
#
# The figure shows level curves at 2 % and 4 % of the radius and at 2° and 4°.

MARGIN: Final = 1.25
"""Half width of the window around a ball, contact radii."""

INNER_FRACTION: Final = 0.9
"""Errors are evaluated within this fraction of the contact radius: at the rim the skin lifts off."""


@dataclass(frozen=True, slots=True, eq=False)
class BallError:
    """One ball as one method reconstructs it, in a window around the ball.

    height : height map of the window
    height_um : float32 array of shape (h, w), height error, µm, minus its median over the inner contact
    angle_deg : float32 array of shape (h, w), error of the normal, degrees
    inside, inner : bool arrays of shape (h, w), the contact and its inner part, without invalid pixels
    radius_um : radius of the ball
    press : name of the press
    """

    method: Method
    height: HeightMap
    height_um: Float32Array
    angle_deg: Float32Array
    inside: MaskArray
    inner: MaskArray
    radius_um: float
    press: str

    @property
    def height_percent(self) -> Float32Array:
        """Absolute height error as a percentage of the ball radius, float32 array of shape (h, w)."""
        return np.asarray(100.0 * np.abs(self.height_um) / self.radius_um, np.float32)


def held_out_ball_errors(
    frames: CalibrationFrames, calibration: Calibration, progress: Callable[[str], None] = lambda _: None
) -> tuple[BallError, ...]:
    """Return errors by every method for a typical ball (median held-out error), which is left out of the calibration.

    calibration : made from all frames; its ball centres are taken as true

    Raises
    ------
    CalibrationError
        There is only one ball.
    """
    press, ball = _typical_ball(calibration)
    progress("calibrating without one ball")
    without_ball = calibrate_frames(replace(frames.without(calibration, press, ball), paper=True))
    errors = []
    for method in METHODS:
        progress(f"reconstructing the ball, {method}")
        name = calibration.presses[press].name
        found = reconstruct(frames.presses[press].frame, without_ball, name, method)
        errors.append(_error(found.height, (found.p, found.q), ball, method, name))
    return tuple(errors)


def _typical_ball(calibration: Calibration) -> tuple[int, Ball]:
    """Press number and ball with the median held-out error."""
    balls = [(number, ball) for number, press in enumerate(calibration.presses) for ball in press.balls]
    if len(balls) < 2:
        raise CalibrationError("only one ball, so none can be held out: press the ball at several places")
    error = calibration.inverse.ball_error_deg[calibration.inverse.kept]
    return balls[int(np.argsort(error)[len(balls) // 2])]


def _truth(
    ball: Ball, column: Float32Array, row: Float32Array, pitch_um: float
) -> tuple[Float32Array, Float32Array, Float32Array]:
    """Return slopes over pixels and height (µm, zero anywhere) of the sphere that pixels see, arrays of their shape."""
    p, q = sphere_slopes(ball, column, row)
    if ball.viewpoint is None:
        squared = (column - ball.column) ** 2 + (row - ball.row) ** 2
        return p, q, np.asarray(np.sqrt(np.maximum(ball.radius_px**2 - squared, 0.0)) * pitch_um, np.float32)
    rise_px = ball.radius_px / np.sqrt(1.0 + p * p + q * q)
    z_px = np.asarray(ball.apex_px - ball.radius_px + rise_px, np.float32)
    everywhere = GradientField(p, q, np.ones(p.shape, np.bool_), np.ones(p.shape, np.float32))
    own = ball.viewpoint
    within = Viewpoint(own.column - float(column[0, 0]), own.row - float(row[0, 0]), own.height_px)
    seen = seen_slopes(everywhere, within, HeightMap(z_px, 1.0))
    return seen.p, seen.q, np.asarray(z_px * pitch_um, np.float32)


def _error(
    height: HeightMap, slopes: tuple[Float32Array, Float32Array], ball: Ball, method: Method, press: str
) -> BallError:
    reach = int(np.ceil(MARGIN * ball.contact_radius_px))
    rows, columns = (
        slice(max(round(place) - reach, 0), min(round(place) + reach + 1, size))
        for place, size in zip((ball.row, ball.column), height.z_um.shape, strict=True)
    )
    row, column = np.mgrid[rows, columns].astype(np.float32)
    distance = np.hypot(column - ball.column, row - ball.row)
    z_um, p, q = height.z_um[rows, columns], slopes[0][rows, columns], slopes[1][rows, columns]
    valid = np.isfinite(z_um) & np.isfinite(p) & np.isfinite(q)
    inside = (distance < ball.contact_radius_px) & valid
    inner = (distance < INNER_FRACTION * ball.contact_radius_px) & valid
    pt, qt, sphere_um = _truth(ball, column, row, height.pitch_um)
    cosine = (p * pt + q * qt + 1.0) / np.sqrt((1.0 + p**2 + q**2) * (1.0 + pt**2 + qt**2))
    off_um = z_um - sphere_um
    return BallError(
        method=method,
        height=HeightMap(z_um, height.pitch_um),
        height_um=np.asarray(off_um - np.median(off_um[inner]), np.float32),
        angle_deg=np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))).astype(np.float32),
        inside=inside,
        inner=inner,
        radius_um=ball.radius_px * height.pitch_um,
        press=press,
    )


LEVELS: Final = (2.0, 4.0)
SCALE_END: Final = 6.0
CURVE_BLUR_FRACTION: Final = 0.015
"""Standard deviation of the Gaussian over the errors from which curves are drawn, as a fraction of the window."""

METHOD_NAMES: Final = {"direct": "default: direct inverse map", "paper": "paper's method"}

_CAPTION: Final = (
    "A ball that was left out of the calibration, by each method. Upper row: height error in percent of the ball's "
    "radius, minus its median because the ball's own height above the skin is not known. Lower row: error of the "
    "surface normal. Bright is small, dark is large; the black curve is at 2, the white one at 4. Dotted: the inner "
    "90 % of the contact, over which means are taken. Pixel noise is smoothed out for the curves, but not for the "
    "numbers."
)


def ball_error_figure(errors: Sequence[BallError]) -> Figure:
    """Return one column per method: height error above, angular error below."""
    figure = Figure(figsize=(4.6 * len(errors) + 1.6, 9.9), layout="constrained")
    grid = figure.subplots(2, len(errors), squeeze=False, sharex=True, sharey=True)
    for column, error in enumerate(errors):
        upper, lower = grid[0][column], grid[1][column]
        percent = _draw(upper, error, error.height_percent)
        upper.set_title(f"{METHOD_NAMES[error.method]}\n{_height_text(error)}", fontsize=10)
        degrees = _draw(lower, error, error.angle_deg)
        lower.set_title(_angle_text(error), fontsize=10)
        lower.set_xlabel("column, mm")
    for line, shown, label in (
        (grid[0], percent, "height error, % of radius"),
        (grid[1], degrees, "error of normal, °"),
    ):
        line[0].set_ylabel("row, mm")
        figure.colorbar(shown, ax=line, shrink=0.85, extend="max", label=label)
    first = errors[0]
    figure.suptitle(f"Ball of radius {first.radius_um / 1e3:.4g} mm in {_short(first.press)}", fontsize=12)
    caption(figure, _CAPTION)
    return figure


def _draw(axes: Axes, error: BallError, values: Float32Array) -> Any:
    """Show errors inside the contact as colours, with level curves."""
    mm = error.height.pitch_um / 1e3
    rows, columns = values.shape
    shown = np.where(error.inside, values, np.nan)
    image = axes.imshow(
        shown,
        cmap="cividis_r",
        vmin=0.0,
        vmax=SCALE_END,
        extent=(0.0, columns * mm, rows * mm, 0.0),
        interpolation="nearest",
    )
    x, y = (np.arange(columns) + 0.5) * mm, (np.arange(rows) + 0.5) * mm
    smooth = np.ma.masked_where(~error.inner, _smoothed(error, values))
    for level, colour in zip(LEVELS, ("black", "white"), strict=True):
        if smooth.max() > level > smooth.min():
            axes.contour(x, y, smooth, levels=[level], colors=[colour], linewidths=1.4)
    axes.contour(x, y, error.inner.astype(np.float32), levels=[0.5], colors=["dimgray"], linewidths=1.0, linestyles=":")
    return image


def _smoothed(error: BallError, values: Float32Array) -> Float32Array:
    """Return gaussian mean over the contact, so that curves show the shape of the error without its noise."""
    sigma_px = max(CURVE_BLUR_FRACTION * max(values.shape), 0.8)
    weight = cv2.GaussianBlur(error.inside.astype(np.float32), (0, 0), sigma_px)
    total = cv2.GaussianBlur(np.where(error.inside, values, np.float32(0.0)), (0, 0), sigma_px)
    return np.asarray(total / np.maximum(weight, 1e-6), np.float32)


def _height_text(error: BallError) -> str:
    off_um, percent = np.abs(error.height_um[error.inner]), error.height_percent[error.inner]
    return f"height: mean {off_um.mean():.2g} µm ({percent.mean():.2f} % of R)\n{_fractions_within(percent, ' %')}"


def _angle_text(error: BallError) -> str:
    angle = error.angle_deg[error.inner]
    return f"normal: mean {angle.mean():.2f}°, median {np.median(angle):.2f}°\n{_fractions_within(angle, '°')}"


def _fractions_within(values: Float32Array, unit: str) -> str:
    within = [f"{(values <= level).mean() * 100.0:.0f} % within {level:g}{unit}" for level in LEVELS]
    return ", ".join(within)


def _short(press: str) -> str:
    """Return a press's name without the folders of its file."""
    return f"{press.split(' (')[0]} ({Path(press.split(' (')[1].rstrip(')')).name})" if " (" in press else press
