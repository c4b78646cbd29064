"""What a Python program hands to `host_sync.api`, checked: wrong values end in one sentence."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import numpy as np

from device.balls.sphere import Ball
from device.imaging.flat_field import LinearFrame
from host_sync.calibration.balls import GridSpacing, PressFrame
from host_sync.calibration_file.kept_calibration import KeptCalibration
from host_sync.errors import CalibrationFileError, FrameSetError
from host_sync.frames.frame_set import FrameSpec, check_ball
from host_sync.frames.frame_set_file import MAX_LIGHTS
from host_sync.frames.linear_light import frame_of_values, read_frame

if TYPE_CHECKING:
    from host_sync.api import Encoding, Image, Press


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


def press_frame(number: int, press: Press, pixel_pitch_um: float, encoding: Encoding) -> PressFrame:
    """The press as calibration takes it; FrameSetError when its image or a length is none."""
    if not hasattr(press, "ball_radius_mm"):
        raise FrameSetError(f"press {number} is a {type(press).__name__}: give api.Press(image, ball_radius_mm=...)")
    for name, value in (("pixel_pitch_um", pixel_pitch_um), ("ball_radius_mm", press.ball_radius_mm)):
        if not (math.isfinite(value) and value > 0.0):
            raise FrameSetError(f"{name} {value:g} is out of range; accepted is a number above 0")
    frame = linear_frame(press.image, encoding)
    radius_px = press.ball_radius_mm * 1e3 / pixel_pitch_um
    for i, ball in enumerate(press.balls or ()):
        if len(ball) != 3:
            raise FrameSetError(
                f"press {number}: balls[{i}]: give (column, row, radius of the trusted contact), pixels"
            )
        check_ball(Ball(*ball, radius_px), frame.rgb.shape[:2], f"press {number}: balls[{i}]")
    return PressFrame(
        name=f"press-{number:02d}",
        frame=frame,
        radius_px=radius_px,
        balls=None if press.balls is None else tuple(Ball(*ball, radius_px) for ball in press.balls),
        labelled_by_hand=press.balls is not None,
        source=Path(press.image).name if isinstance(press.image, str | Path) else "",
        grid=GridSpacing(press.grid_pitch_mm) if press.grid_pitch_mm else None,
    )


def linear_frame(image: Image, encoding: Encoding) -> LinearFrame:
    """The image as linear light; FrameSetError when it is not an image."""
    if isinstance(image, np.ndarray):
        return frame_of_values(image, encoding)
    paths: tuple[Any, ...] = (image,) if isinstance(image, str | Path) else tuple(image) if _is_series(image) else ()
    if not 1 <= len(paths) <= MAX_LIGHTS or not all(isinstance(path, str | Path) for path in paths):
        raise FrameSetError(
            f"a {type(image).__name__} is no frame: name an RGB image, or a grey one a light, or give a numpy array"
        )
    return read_frame(FrameSpec(tuple(Path(path) for path in paths), encoding))


def _is_series(image: object) -> bool:
    return isinstance(image, tuple | list)
