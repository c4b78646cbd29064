"""The pixel pitch that ball grids of known spacing measure, with its standard uncertainty.

It holds at the height of the balls' tops: an object there fills as many pixels as the balls do. Untouched skin lies
lower and, seen from a finite distance, has a pitch that is larger by the depth of the press over that distance. It is
the mean over the places of the balls: where no ball is, a bent lens is not known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np

from device.balls.sphere import Ball
from device.calibration.acceptance import MAX_PITCH_ERROR, PITCH_COVERAGE
from device.errors import CalibrationError
from device.surface import Float64Array
from host_sync.calibration.balls import GridSpacing
from host_sync.calibration.lattice import BallLattice

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
        """Sentence that states how the stated pitch is wrong, empty when it is not."""
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
    """Return the weighted mean of readings.

    Its uncertainty is their scatter where they differ by more than their own uncertainties.

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
    if abs(stated_um / mean - 1.0) > MAX_PITCH_ERROR:
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


# Pose of a ball grid before the camera: turned and scaled, sheared, in perspective, bent by the lens.
#
# Balls that the fit did not see decide how rich a pose the data support. From the simplest pose on, a richer one is
# taken when it predicts held-out balls better by more than that gain's own standard error: a lens that bends by less
# than that is left straight.

PoseName = Literal["similarity", "affine", "homography"]
FOLDS: Final = 10
STEPS: Final = 12
AT_REST: Final = 1e-7
"""Parameters are sought in at most so many steps, until they move by less."""

HUBER: Final = 2.0
"""Residuals beyond this many standard deviations weigh less."""

SPARE: Final = 4
"""Coordinates of balls that must be left over when each parameter has taken one."""

_PARAMETERS: Final[dict[PoseName, int]] = {"similarity": 4, "affine": 6, "homography": 8}


@dataclass(frozen=True, slots=True)
class PoseModel:
    """A form of pose: how the plane of the grid is seen, and whether the lens bends radially."""

    plane: PoseName
    radial: bool

    @property
    def parameters(self) -> int:
        """Number of parameters."""
        return _PARAMETERS[self.plane] + self.radial

    @property
    def name(self) -> str:
        """Name in the report."""
        return f"{self.plane} and radial distortion" if self.radial else self.plane


MODELS: Final = tuple(
    sorted((PoseModel(p, radial) for p in _PARAMETERS for radial in (False, True)), key=lambda model: model.parameters)
)


@dataclass(frozen=True, slots=True, eq=False)
class GridPose:
    """A fitted pose.

    shape : (H, W) of the frame; radial distortion is about its middle
    parameters, covariance : float64 arrays of shape (K,) and (K, K), lengths in half diagonals of the frame
    fitted_px : root mean square distance of a ball from its place along one axis
    held_out_px : the same of balls that the fit did not see, by name of every model that was tried
    """

    model: PoseModel
    shape: tuple[int, int]
    parameters: Float64Array
    covariance: Float64Array
    fitted_px: float
    held_out_px: dict[str, float]

    def pixels(self, places: Float64Array) -> Float64Array:
        """(column, row) at which places of the lattice, array of shape (N, 2) in steps, are seen."""
        return _seen(self.model, self.parameters, places, self.shape)


def fit_pose(places: Float64Array, points: Float64Array, shape: tuple[int, int]) -> GridPose:
    """Return the pose in which places of a lattice are seen at points of a frame.

    places : float64 array of shape (N, 2), steps
    points : float64 array of shape (N, 2), (column, row)
    shape : (H, W)
    """
    usable = [model for model in MODELS if model.parameters + SPARE <= points.size] or [MODELS[0]]
    errors = {model: _held_out_errors(model, places, points, shape) for model in usable}
    chosen = _preferred(usable, errors)
    parameters, weight, normal = _fit(chosen, places, points, shape)
    residual = _seen(chosen, parameters, places, shape) - points
    spread_px = float(np.sqrt(np.mean(errors[chosen])))
    covariance = np.asarray(np.linalg.inv(normal), np.float64) * (spread_px / _half_diagonal(shape)) ** 2
    fitted_px = float(np.sqrt((weight[:, None] * residual**2).sum() / (2.0 * weight.sum())))
    held_out = {model.name: float(np.sqrt(np.mean(error))) for model, error in errors.items()}
    return GridPose(chosen, shape, parameters, covariance, fitted_px, held_out)


def _preferred(models: Sequence[PoseModel], errors: dict[PoseModel, Float64Array]) -> PoseModel:
    """Return the richest model in a row of models each of which is surely better than the last one taken."""
    chosen = models[0]
    for model in models[1:]:
        gain = errors[chosen] - errors[model]
        if gain.mean() > gain.std(ddof=1) / np.sqrt(len(gain)):
            chosen = model
    return chosen


def _held_out_errors(
    model: PoseModel, places: Float64Array, points: Float64Array, shape: tuple[int, int]
) -> Float64Array:
    """Return the squared distance (px²) of each ball from where the others put it, shape (N,).

    It is the mean over both axes. Errors beyond `HUBER` times the median distance are cut there: one bad ball does not
    choose the model.
    """
    fold = np.arange(len(points)) % min(FOLDS, len(points))
    square = np.zeros(len(points))
    for number in range(int(fold.max()) + 1):
        out = fold == number
        parameters, _, _ = _fit(model, places[~out], points[~out], shape)
        square[out] = ((_seen(model, parameters, places[out], shape) - points[out]) ** 2).mean(axis=1)
    return np.asarray(np.minimum(square, (2.0 * HUBER) ** 2 * np.median(square)))


def _fit(
    model: PoseModel, places: Float64Array, points: Float64Array, shape: tuple[int, int]
) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Return parameters, the balls' weights (N,), and the normal matrix, by Gauss-Newton with Huber weights."""
    parameters = _start(model, places, points, shape)
    weight, normal = np.ones(len(points)), np.eye(model.parameters)
    for _ in range(STEPS):
        residual = (points - _seen(model, parameters, places, shape)) / _half_diagonal(shape)
        away = np.hypot(*residual.T)
        limit = HUBER * max(float(np.median(away)), 1e-9)
        weight = limit / np.maximum(away, limit)
        jacobian = _jacobian(model, parameters, places, shape)
        normal = np.einsum("n,nak,nal->kl", weight, jacobian, jacobian)
        step = np.linalg.solve(normal, np.einsum("n,nak,na->k", weight, jacobian, residual))
        parameters = parameters + step
        if np.abs(step).max() < AT_REST:
            break
    return parameters, weight, normal


def _start(model: PoseModel, places: Float64Array, points: Float64Array, shape: tuple[int, int]) -> Float64Array:
    """Return parameters of the similarity that fits best, in the order of `_seen`."""
    along = places[:, 0] + 1j * places[:, 1]
    offset = (points - _middle(shape)) / _half_diagonal(shape)
    seen = offset[:, 0] + 1j * offset[:, 1]
    design = np.stack([along, np.ones_like(along)], axis=1)
    turn, shift = np.linalg.lstsq(design, seen, rcond=None)[0]
    start = [turn.real, turn.imag, shift.real, shift.imag]
    if model.plane != "similarity":
        start += [-turn.imag, turn.real]
    return np.array(start + [0.0] * (model.parameters - len(start)))


def _seen(model: PoseModel, parameters: Float64Array, places: Float64Array, shape: tuple[int, int]) -> Float64Array:
    """(column, row) of places under a pose."""
    first = parameters[:2]
    second = np.array([-first[1], first[0]]) if model.plane == "similarity" else parameters[4:6]
    flat = places[:, :1] * first + places[:, 1:] * second + parameters[2:4]
    if model.plane == "homography":
        flat = flat / (1.0 + places @ parameters[6:8])[:, None]
    if model.radial:
        flat = flat * (1.0 + parameters[-1] * (flat**2).sum(axis=1, keepdims=True))
    return np.asarray(_middle(shape) + _half_diagonal(shape) * flat)


def _jacobian(model: PoseModel, parameters: Float64Array, places: Float64Array, shape: tuple[int, int]) -> Float64Array:
    """Return derivatives of the places seen, in half diagonals, by the parameters: float64 array of shape (N, 2, K)."""
    small = 1e-6
    columns = []
    for step in small * np.eye(len(parameters)):
        ahead, behind = (_seen(model, parameters + sign * step, places, shape) for sign in (1.0, -1.0))
        columns.append((ahead - behind) / (2.0 * small * _half_diagonal(shape)))
    return np.stack(columns, axis=-1)


def _middle(shape: tuple[int, int]) -> Float64Array:
    return np.array([shape[1] - 1.0, shape[0] - 1.0]) / 2.0


def _half_diagonal(shape: tuple[int, int]) -> float:
    return float(np.hypot(*_middle(shape)))
