"""Pose of a ball grid before the camera: turned and scaled, sheared, in perspective, bent by the lens.

What the data support is asked of balls that the fit did not see. From the simplest pose on, a richer one is taken when
it predicts held-out balls better by more than that gain's own standard error: a lens that bends by less than the balls
can tell is left straight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from device.surface.fields import Float64Array

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
        """As the report says it."""
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
    """Return the mean over both axes of the squared distance (px²) of each ball from where the others put it, shape
    (N,).

    Errors beyond `HUBER` times the median distance are cut there: one bad ball does not choose the model.
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
