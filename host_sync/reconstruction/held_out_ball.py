"""Errors of a ball that the calibration never saw, by each method (paper, section 6 and Fig. 5)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from device.ball import Ball, sphere_slopes
from device.errors import CalibrationError
from device.surface import Float32Array, HeightMap, MaskArray
from host_sync.calibration.calibration_frames import CalibrationFrames, calibrate_frames
from host_sync.calibration.full_calibration import METHODS, Calibration, Method
from host_sync.reconstruction.pipeline import reconstruct

MARGIN: Final = 1.25
"""The window around a ball reaches this many contact radii from its centre."""

INNER_SHARE: Final = 0.9
"""Errors are stated within this share of the contact's radius: at its rim the skin lifts off."""


@dataclass(frozen=True, slots=True, eq=False)
class BallError:
    """One ball as one method reconstructs it, in a window around the ball.

    height : the height map in the window
    height_um : float32 array of shape (h, w), height error, µm, its median over the inner contact taken off
    angle_deg : float32 array of shape (h, w), error of the normal, degrees
    inside, inner : bool arrays of shape (h, w), the contact and its inner part; no invalid pixel is among them
    radius_um : of the ball
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
        """Absolute height error as a percentage of the ball's radius, float32 array of shape (h, w)."""
        return np.asarray(100.0 * np.abs(self.height_um) / self.radius_um, np.float32)


def held_out_ball_errors(
    frames: CalibrationFrames, calibration: Calibration, tell: Callable[[str], None] = lambda _: None
) -> tuple[BallError, ...]:
    """The errors, by every method, of a typical ball (the one of median held-out error) that taught nothing.

    calibration : made from all of the frames; its ball centres are taken as true

    Raises
    ------
    CalibrationError
        There is one ball only.
    """
    press, ball = _typical_ball(calibration)
    tell("calibrating without one ball")
    taught = calibrate_frames(frames.without(calibration, press, ball))
    errors = []
    for method in METHODS:
        tell(f"reconstructing the ball, {method}")
        name = calibration.presses[press].name
        found = reconstruct(frames.presses[press].frame, taught, name, method)
        errors.append(_error(found.height, (found.p, found.q), ball, method, name))
    return tuple(errors)


def _typical_ball(calibration: Calibration) -> tuple[int, Ball]:
    """Number of the press and ball whose held-out error is the median of all balls'."""
    balls = [(number, ball) for number, press in enumerate(calibration.presses) for ball in press.balls]
    if len(balls) < 2:
        raise CalibrationError("there is one ball only, and none to judge it by: press the ball at several places")
    error = calibration.inverse.ball_error_deg[calibration.inverse.kept]
    return balls[int(np.argsort(error)[len(balls) // 2])]


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
    inner = (distance < INNER_SHARE * ball.contact_radius_px) & valid
    pt, qt = sphere_slopes(ball, column, row)
    cosine = (p * pt + q * qt + 1.0) / np.sqrt((1.0 + p**2 + q**2) * (1.0 + pt**2 + qt**2))
    sphere_um = np.sqrt(np.maximum(ball.radius_px**2 - distance**2, 0.0)) * height.pitch_um
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
