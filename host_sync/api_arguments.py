"""Checks of the arguments of `host_sync.api`, whose errors are one sentence, and the streams that it returns."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import numpy as np

from device.balls.sphere import Ball
from device.errors import DeviceError
from device.imaging.flat_field import LinearFrame
from device.surface import Float32Array, GradientField
from host_sync.api_types import HeightStream
from host_sync.calibration.balls import GridSpacing, PressFrame
from host_sync.calibration_file.kept_calibration import KeptCalibration
from host_sync.errors import (
    ArgumentError,
    CalibrationFileError,
    FrameSetError,
    HostError,
    IntegrationError,
)
from host_sync.frames.channels import check_channels, count_values, full_scale_of
from host_sync.frames.frame_set import FrameSpec, check_ball, square_ball
from host_sync.frames.frame_set_file import MAX_LIGHTS
from host_sync.frames.image_file import read_image, read_info
from host_sync.frames.image_info import check_one_orientation, square_pitch
from host_sync.frames.linear_light import frame_of_values, read_frame
from host_sync.kernels.jit import get_num_threads, set_num_threads
from host_sync.results.reader import ResultSurface, read_result
from host_sync.video.frame_solver import FrameSolver
from host_sync.video.stream import in_order, open_live

if TYPE_CHECKING:
    from host_sync.api_types import Encoding, Image, Method, Press, Result


def check_choice(name: str, value: object, choices: object) -> None:
    """Refuse a word that is none of a Literal's with a FrameSetError."""
    if value not in get_args(choices):
        raise FrameSetError(f"{name} {value!r} is not accepted; accepted: {', '.join(map(repr, get_args(choices)))}")


def check_calibration(given: object) -> None:
    """Refuse what is no calibration with a CalibrationFileError."""
    if not isinstance(given, KeptCalibration):
        raise CalibrationFileError(
            f"a {type(given).__name__} is no calibration: give what calibrate, calibrate_frame_set or "
            "load_calibration returns"
        )


def surface_of(result: object) -> ResultSurface:
    """Return the surface of a Result or of a result's folder.

    Raises
    ------
    ArgumentError
        It is neither.
    UnreadableResult
        A file of the folder is missing or damaged.
    """
    if isinstance(surface := getattr(result, "surface", None), ResultSurface):
        return surface
    if isinstance(result, str | os.PathLike):
        return read_result(as_path("result", result))
    raise ArgumentError(f"result must be a Result, or the folder of one, not {type(result).__name__}")


def as_path(name: str, given: object) -> Path:
    """Return the path; ArgumentError when it is neither a text nor a path, or an empty text.

    name : the argument's
    """
    if given == "":
        raise ArgumentError(f"{name} must name a file or folder, and is an empty text")
    if isinstance(given, str | os.PathLike):
        return Path(given)
    raise ArgumentError(f"{name} must be a text or a pathlib.Path, not {type(given).__name__}")


def as_paths(name: str, given: object) -> list[Path]:
    """Return the paths of a list; errors as for `as_path`, and where it is none."""
    if isinstance(given, str | os.PathLike) or not isinstance(given, Iterable):
        raise ArgumentError(f"{name} must be a list of paths, not {type(given).__name__}")
    return [as_path(f"{name}[{i}]", one) for i, one in enumerate(given)]


def positive(name: str, given: object, error: type[HostError]) -> float:
    """Return the number above zero; `error` when it is none."""
    number = _number(given)
    if math.isfinite(number) and number > 0.0:
        return number
    said = repr(given) if math.isnan(number) else f"{number:g}"
    raise error(f"{name} {said} is out of range; accepted is a number above 0")


def _number(given: Any) -> float:
    """Return the number, NaN for anything else; a text is none."""
    try:
        return float("nan") if isinstance(given, str | bytes) else float(given)
    except (TypeError, ValueError, OverflowError):
        return float("nan")


def pitch_of(given: object) -> float:
    """Return the pixel pitch of slopes, µm; IntegrationError when it is not a number above 0."""
    return positive("pitch_um", given, IntegrationError)


def height_of(given: object) -> float | None:
    """Return the height of the camera's pupil, mm; FrameSetError when it is given and not a number above 0."""
    return None if given is None else positive("pupil_height_mm", given, FrameSetError)


def gradient_field(p: object, q: object, weights: object) -> GradientField:
    """Return the slopes and their weights as integration takes them, a hole wherever one of them is none.

    Raises
    ------
    IntegrationError
        One of them is no array of numbers, shapes differ, or every pixel is a hole.
    """
    slope_p, slope_q = _numbers("p", p), _numbers("q", q)
    trusted = np.ones(slope_p.shape, np.float32) if weights is None else _numbers("weights", weights)
    if slope_p.ndim != 2 or not slope_p.shape == slope_q.shape == trusted.shape:
        shapes = f"p {slope_p.shape}, q {slope_q.shape}" + ("" if weights is None else f", weights {trusted.shape}")
        raise IntegrationError(f"arrays must have one shape (H, W), got {shapes}")
    valid = (trusted != 0.0) & np.isfinite(slope_p) & np.isfinite(slope_q)
    if not valid.any():
        raise IntegrationError("no pixel has finite slopes p and q and a weight above 0: nothing can be integrated")
    return GradientField(slope_p, slope_q, valid, np.where(valid, trusted, np.float32(0.0)))


def _numbers(name: str, given: Any) -> Float32Array:
    """Return the array, float32; masked values become NaN (0 where they are weights)."""
    wrong = IntegrationError(f"{name} must be an array of numbers of shape (H, W), not {type(given).__name__}")
    if given is None or isinstance(given, str | bytes | os.PathLike | dict):
        raise wrong
    try:
        values = np.ma.asanyarray(given) if isinstance(given, np.ma.MaskedArray) else np.asarray(given)
        if (kind := values.dtype.kind) not in "biufO":
            raise IntegrationError(
                f"{name} must hold real numbers, not {'texts' if kind in 'US' else values.dtype.name}"
            )
        with np.errstate(over="ignore"):  # beyond single precision is infinite: a hole
            numbers = values.astype(np.float32)
    except (TypeError, ValueError) as error:
        if isinstance(error, IntegrationError):
            raise
        raise wrong from error
    filled = np.ma.filled(numbers, np.float32(0.0 if name == "weights" else np.nan))
    return np.ascontiguousarray(filled) if filled.ndim else filled


def press_list(presses: object) -> list[Press]:
    """Return the presses; ArgumentError where they are no list, FrameSetError where one of them is none."""
    if not isinstance(presses, Iterable):
        raise ArgumentError(f"presses must be a list, [api.Press(...), ...], not {type(presses).__name__}")
    listed = list(presses)
    for number, press in enumerate(listed):
        if not hasattr(press, "ball_radius_mm"):
            kind = type(press).__name__
            raise FrameSetError(f"press {number} is a {kind}: give api.Press(image, ball_radius_mm=...)")
    return listed


def pitch_and_shape(given: object) -> tuple[float, float]:
    """Return the pitch of square pixels and the shape of the stored ones; FrameSetError where it is none."""
    pair = tuple(given) if isinstance(given, tuple | list) else (given,)
    if not 1 <= len(pair) <= 2:
        raise FrameSetError(
            f"pixel_pitch_um {given!r} is not accepted; give a number, or two: along a row, down a column"
        )
    numbers = [positive("pixel_pitch_um", one, FrameSetError) for one in pair]
    return square_pitch(tuple(numbers) if len(numbers) == 2 else numbers[0])


def image_form(images: Sequence[Image], encoding: Encoding, full_scale: object, pixel_shape: float) -> FrameSpec:
    """Return what images have in common, as a frame without images.

    full_scale : as given; None finds it where images have 16 bit

    Raises
    ------
    FrameSetError
        It is not certain, or no count.
    """
    form = FrameSpec((), encoding, None, pixel_shape)
    arrays = [image for image in images if isinstance(image, np.ndarray)]
    files = [Path(path) for image in images if not isinstance(image, np.ndarray) for path in _paths(image)]
    known = {path: read_info(path) for path in files}
    check_one_orientation(known)
    given = None if full_scale is None else round(positive("full_scale", full_scale, FrameSetError))
    deep: list[Any] = [array for array in arrays if array.dtype == np.uint16]
    deep += [path for path in files if known[path].bits == 16 and not known[path].is_raw]
    stated = max((info.full_scale or 0 for info in known.values()), default=0)
    if not deep:
        return replace(form, full_scale=given)
    counts = count_values(read_image(one) if isinstance(one, Path) else one for one in deep)
    return replace(form, full_scale=full_scale_of(counts, stated or None, encoding, given))


def press_frame(number: int, press: Press, pixel_pitch_um: float, form: FrameSpec) -> PressFrame:
    """Return the press as calibration takes it; FrameSetError when its image or a length is none."""
    radius_px = positive("ball_radius_mm", press.ball_radius_mm, FrameSetError) * 1e3 / pixel_pitch_um
    spacing = press.grid_pitch_mm
    grid = None if spacing is None else GridSpacing(positive("grid_pitch_mm", spacing, FrameSetError))
    frame = linear_frame(press.image, form)
    images = [Path(path) for path in _paths(press.image)] if _is_series(press.image) else []
    check_channels(frame.rgb, f"press {number}", images)
    balls = None if press.balls is None else _balls(f"press {number}", press.balls, radius_px)
    if balls and form.pixel_shape != 1.0:
        stored = stored_shape(press.image)
        balls = tuple(square_ball(ball, stored, form.pixel_shape) for ball in balls)
    for i, ball in enumerate(balls or ()):
        check_ball(ball, frame.rgb.shape[:2], f"press {number}: balls[{i}]")
    return PressFrame(
        name=f"press-{number:02d}",
        frame=frame,
        radius_px=radius_px,
        balls=balls,
        labelled_by_hand=press.balls is not None,
        source=Path(press.image).name if isinstance(press.image, str | Path) else "",
        grid=grid,
    )


def _balls(press: str, given: object, radius_px: float) -> tuple[Ball, ...]:
    """Labelled balls; FrameSetError when one is not three numbers."""
    if not isinstance(given, Iterable):
        raise FrameSetError(f"{press}: balls must be a list, [(column, row, radius), ...], not {type(given).__name__}")
    balls = []
    for i, ball in enumerate(given):
        numbers = [_number(one) for one in ball] if isinstance(ball, Iterable) else []
        if len(numbers) != 3 or not all(map(math.isfinite, numbers)):
            raise FrameSetError(f"{press}: balls[{i}]: give (column, row, radius of the trusted contact), pixels")
        x, y, contact_px = numbers
        balls.append(Ball(x, y, contact_px, radius_px))
    return tuple(balls)


def linear_frame(image: Image, form: FrameSpec) -> LinearFrame:
    """Return the image as linear light on square pixels; FrameSetError when it is not an image."""
    if isinstance(image, np.ndarray):
        return frame_of_values(image, form.encoding, form.full_scale, form.pixel_shape)
    return read_frame(replace(form, images=tuple(Path(path) for path in _paths(image))))


def stored_shape(image: Image) -> tuple[int, int]:
    """(H, W) of an image as it is stored."""
    if isinstance(image, np.ndarray):
        return image.shape[0], image.shape[1]
    return read_info(Path(_paths(image)[0])).shape


def _paths(image: Any) -> tuple[Any, ...]:
    """Return the files of an image; FrameSetError when it names none."""
    paths: tuple[Any, ...] = (image,) if isinstance(image, str | Path) else tuple(image) if _is_series(image) else ()
    if not 1 <= len(paths) <= MAX_LIGHTS or not all(isinstance(path, str | Path) for path in paths):
        raise FrameSetError(
            f"a {type(image).__name__} is no frame: name an RGB image, or a grey one a light, or give a numpy array"
        )
    return paths


def _is_series(image: object) -> bool:
    return isinstance(image, tuple | list)


def check_workers(given: object) -> int:
    """Return the number of workers; ArgumentError when it is no whole number above 0."""
    if given is None:
        return os.cpu_count() or 1
    if isinstance(given, int) and given > 0:
        return given
    raise ArgumentError(f"workers {given!r} is not accepted; accepted is a whole number above 0")


def reconstructed_in_order(
    reconstruct: Callable[[Image], Result], images: Iterable[Image], workers: int | None
) -> Iterator[Result | HostError | DeviceError]:
    """Yield what `reconstruct` returns of every image, or the error that it raises, a thread for each worker."""

    def guarded(image: Image) -> Result | HostError | DeviceError:
        try:
            return reconstruct(image)
        except (HostError, DeviceError) as error:
            return error

    workers = check_workers(workers)
    threads = -(-get_num_threads() // workers)
    with ThreadPoolExecutor(workers, "images", set_num_threads, (threads,)) as executor:
        yield from in_order((executor.submit(guarded, image) for image in images), workers)


def open_stream(
    source: Any, calibration: KeptCalibration, kept: str | None, sigma: bool, encoding: Encoding | None,
    full_scale: int | None, method: Method | None, force: bool,
) -> HeightStream:  # fmt: skip
    """Return the stream of a source; arguments as of `host_sync.api.stream`, checked."""
    solver = FrameSolver.of(calibration, method, encoding, full_scale=full_scale, force=force)
    live = open_live(source, solver, newest=None if kept is None else kept == "newest", sigma=sigma)
    return HeightStream(live, solver)
