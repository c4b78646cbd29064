"""The pixel pitch that ball grids of known spacing measure, with its standard uncertainty.

It holds at the height of the balls' tops: an object there fills as many pixels as the balls do. Untouched skin lies
lower and, seen from a finite distance, has a pitch that is larger by the depth of the press over that distance. It is
the mean over the places of the balls: where no ball is, a bent lens is not known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from device.balls.sphere import Ball
from device.calibration.limits import PITCH_COVERAGE, PITCH_GROSS_SHARE
from device.errors import CalibrationError
from device.surface.fields import Float64Array
from host_sync.calibration.balls import GridSpacing
from host_sync.calibration.lattice import BallLattice
from host_sync.calibration.lattice_pose import GridPose, fit_pose

CENTRE_BIAS: Final = 0.01
"""Share of the radius by which the outermost balls' centres are read too far out or in: lights close by do so, chiefly
because a ball's top stands nearer to them than the reference did (0.7 % on the twin, its lights 25 mm away)."""

RECTANGLE: Final = 3.0**-0.5
"""Standard deviation of a value that may lie anywhere within a tolerance, over that tolerance."""


@dataclass(frozen=True, slots=True)
class PitchReading:
    """The pixel pitch that one press of a ball grid measures.

    pitch_um : mean over the balls, µm per pixel
    scatter_um, bias_um : its standard uncertainty from what differs from ball to ball, and from what does not
    least_um, most_um : over the balls
    balls : number of balls on the grid
    """

    press: str
    grid: GridSpacing
    pitch_um: float
    scatter_um: float
    bias_um: float
    least_um: float
    most_um: float
    balls: int
    pose: GridPose

    @property
    def sigma_um(self) -> float:
        """Standard uncertainty of the pitch but for the grid's own."""
        return float(np.hypot(self.scatter_um, self.bias_um))


@dataclass(frozen=True, slots=True)
class PixelPitch:
    """Pixel pitch measured on all grid presses together.

    stated_um : what the frame set says
    pitch_um, sigma_um : the mean of the readings and its standard uncertainty, µm per pixel; that of the grid's own
        spacing is in it where its tolerance is stated
    """

    stated_um: float
    pitch_um: float
    sigma_um: float
    readings: tuple[PitchReading, ...]

    @property
    def disagreement(self) -> str:
        """The sentence that says how the stated pitch is wrong, empty when it is not."""
        off = self.stated_um - self.pitch_um
        if abs(off) <= PITCH_COVERAGE * self.sigma_um:
            return ""
        return (
            f"the stated pixel pitch of {self.stated_um:g} µm is {off / self.pitch_um:+.2%} off the "
            f"{self.pitch_um:.5g} ± {self.sigma_um:.2g} µm that the ball grid measures, which is used"
        )


def read_pitch(
    press: str, lattice: BallLattice, balls: Sequence[Ball], grid: GridSpacing, shape: tuple[int, int]
) -> PitchReading:
    """Return the pitch that one press measures, from its balls and their lattice, in a frame of `shape` (H, W)."""
    points = np.array([(ball.column, ball.row) for ball in balls])[lattice.on]
    places = lattice.index[lattice.on].astype(np.float64)
    pose = fit_pose(places, points, shape)
    step_um = 1e3 * grid.pitch_mm
    pitches = step_um / _step_px(pose, places)
    gradient = _gradient(pose, places) * step_um
    reach_px = float(np.hypot(*(points - points.mean(axis=0)).T).max())
    return PitchReading(
        press=press,
        grid=grid,
        pitch_um=float(pitches.mean()),
        scatter_um=float(np.sqrt(gradient @ pose.covariance @ gradient)),
        bias_um=float(pitches.mean()) * CENTRE_BIAS * max(ball.radius_px for ball in balls) / reach_px,
        least_um=float(pitches.min()),
        most_um=float(pitches.max()),
        balls=len(places),
        pose=pose,
    )


def join_readings(stated_um: float, readings: Sequence[PitchReading]) -> PixelPitch:
    """Return the weighted mean of readings; where they differ by more than they say, that is its uncertainty.

    What is wrong with every ball alike does not average out.

    Raises
    ------
    CalibrationError
        The stated pitch is grossly wrong.
    """
    weight = np.array([reading.scatter_um**-2.0 for reading in readings])
    values = np.array([reading.pitch_um for reading in readings])
    mean = float((weight * values).sum() / weight.sum())
    inner = float(weight.sum() ** -0.5)
    outer = 0.0
    if len(readings) > 1:
        outer = float(np.sqrt((weight * (values - mean) ** 2).sum() / ((len(readings) - 1) * weight.sum())))
    own = RECTANGLE * max((reading.grid.tolerance_mm or 0.0) / reading.grid.pitch_mm for reading in readings)
    bias = max(reading.bias_um for reading in readings)
    sigma_um = float(np.linalg.norm([max(inner, outer), bias, own * mean]))
    pitch = PixelPitch(stated_um, mean, sigma_um, tuple(readings))
    if abs(stated_um / mean - 1.0) > PITCH_GROSS_SHARE:
        raise CalibrationError(
            f"{readings[0].press}: its {readings[0].balls} balls {readings[0].grid.pitch_mm:g} mm apart make a pixel "
            f"{mean:.4g} ± {sigma_um:.1g} µm, and {stated_um:g} µm is stated ({stated_um / mean - 1.0:+.0%}): "
            "correct pixel_pitch_um or grid_pitch_mm"
        )
    return pitch


def _jacobians(pose: GridPose, places: Float64Array) -> Float64Array:
    """Return pixels per step about places: float64 array of shape (K, 2, 2)."""
    half = 1e-3
    return np.stack(
        [(pose.pixels(places + half * e) - pose.pixels(places - half * e)) / (2.0 * half) for e in np.eye(2)], axis=-1
    )


def _step_px(pose: GridPose, places: Float64Array) -> Float64Array:
    """Geometric mean of a step's length in pixels over both directions, about places: shape (K,)."""
    return np.asarray(np.sqrt(np.abs(np.linalg.det(_jacobians(pose, places)))))


def _gradient(pose: GridPose, places: Float64Array) -> Float64Array:
    """Return the derivative of the mean of 1 / step by the parameters, shape (number of parameters,)."""
    found = []
    for step in 1e-5 * np.eye(len(pose.parameters)):
        ahead, behind = (
            (1.0 / _step_px(replace(pose, parameters=pose.parameters + sign * step), places)).mean()
            for sign in (1.0, -1.0)
        )
        found.append((ahead - behind) / 2e-5)
    return np.array(found)
