"""Numbers of a light model, and derivatives of what `kernels.write_light` writes by places of sources and coat.

The normal equations of a fit hold the shift of each ball in a block of its own.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from device.surface import Float64Array, MaskArray
from host_sync.kernels.jit import njit
from host_sync.kernels.parallel_rows import parallel_rows
from host_sync.light.kernels import GRAZING, to_camera
from host_sync.light.model import POINTS, LightModel, source_points

COAT_TERMS: Final = 10
"""Numbers of `LightModel.coat`."""

EXTENT: Final = 5
"""Numbers of a source's place and extent."""

STEP: Final = 1e-4


def light_derivatives(
    numbers: Numbers, model: LightModel, skin: tuple[Float64Array, ...], light: Float64Array
) -> tuple[Float64Array, Float64Array]:
    """Return derivatives of the light of sources by their places and extents, (N, S, EXTENT), and by the coat.

    skin, light : slopes and places, and the light there, see `LightModel.light`
    """
    count, size = len(numbers.place), len(skin[0])
    extents = np.concatenate([numbers.place, numbers.extent], axis=1)
    moved, turned = np.empty((count, len(POINTS), 4, EXTENT)), np.empty((count, 3, EXTENT))
    for number, step in enumerate(STEP * np.eye(EXTENT)):
        ends = []
        for one in (extents + step, extents - step):
            sources = np.concatenate([one[:, :2], np.exp(one[:, 2:3]), one[:, 3:]], axis=1)
            ends.append(source_points(sources, model.fall_off))
        for there, (far, near) in zip((moved, turned), zip(*ends, strict=True), strict=True):
            there[..., number] = (far - near) / (2.0 * STEP)
    by_source, by_coat = np.empty((size, count, EXTENT)), np.empty((size, count, COAT_TERMS))
    parallel_rows(
        write_light_derivatives, (size, 64), *model.geometry, model.coat, *skin, moved, turned, by_source, by_coat
    )
    distance = np.linalg.norm(model.sources[:, :3], axis=1)
    by_coat[..., 0] += np.log(distance) * light
    return by_source, by_coat @ numbers.coat_change


@njit(cache=True, nogil=True, error_model="numpy")
def write_light_derivatives(
    points: Any, axes: Any, coat: Any, p: Any, q: Any, x: Any, y: Any, z: Any, moved: Any, turned: Any,
    by_source: Any, by_coat: Any, first: int, last: int,
) -> None:  # fmt: skip
    """Write derivatives of the light of each source into the rows `first` to `last` - 1.

    points, axes, coat, p, q, x, y, z : see `write_light`
    moved : derivatives of the points by K numbers of their source, shape (S, points, 4, K)
    turned : derivatives of the axes by them, shape (S, 3, K)
    by_source : receives derivatives by these numbers, shape (N, S, K)
    by_coat : receives derivatives by numbers of the coat at fixed points, shape (N, S, COAT_TERMS)
    """
    by_point, by_axis, shine = np.empty(4), np.empty(3), np.empty(10)
    for i in range(first, last):
        v0, v1, v2 = to_camera(coat[8], x[i], y[i], z[i])
        c0, c1, c2 = to_camera_change(coat[8], x[i], y[i], z[i])
        up = 1.0 / np.sqrt(1.0 + p[i] * p[i] + q[i] * q[i])
        n0, n1 = -p[i] * up, -q[i] * up
        seen = max(n0 * v0 + n1 * v1 + up * v2, GRAZING)
        seen_change = n0 * c0 + n1 * c1 + up * c2 if seen > GRAZING else 0.0
        tilted = 1.0 + coat[6] * (1.0 - up)
        for source in range(points.shape[0]):
            by_source[i, source] = 0.0
            by_coat[i, source] = 0.0
            by_axis[:] = 0.0
            a0, a1, a2 = axes[source]
            for point in range(points.shape[1]):
                d0, d1, d2 = points[source, point, 0] - x[i], points[source, point, 1] - y[i], points[source, point, 2]
                d2 -= z[i]
                square = d0 * d0 + d1 * d1 + d2 * d2
                length = np.sqrt(square)
                l0, l1, l2 = d0 / length, d1 / length, d2 / length
                facing = max(a0 * l0 + a1 * l1 + a2 * l2, 0.0)
                beamed = (1.0 - coat[7]) + coat[7] * facing
                falling = tilted * square ** (-0.5 * coat[0])
                power = falling * points[source, point, 3]
                cosine = n0 * l0 + n1 * l1 + up * l2
                between = l0 * v0 + l1 * v1 + l2 * v2
                write_reflected(max(cosine, 0.0), seen, between, coat, shine)
                reflected, by_lit, by_between = shine[0], shine[1] * (cosine > 0.0), shine[2]
                turning = power * coat[7] * reflected * (facing > 0.0)
                shining = power * beamed
                along = -coat[0] * shining * reflected - turning * facing
                along -= shining * (by_lit * cosine + by_between * between)
                by_point[0] = (along * l0 + turning * a0 + shining * (by_lit * n0 + by_between * v0)) / length
                by_point[1] = (along * l1 + turning * a1 + shining * (by_lit * n1 + by_between * v1)) / length
                by_point[2] = (along * l2 + turning * a2 + shining * (by_lit * up + by_between * v2)) / length
                by_point[3] = falling * beamed * reflected
                by_axis[0] += turning * l0
                by_axis[1] += turning * l1
                by_axis[2] += turning * l2
                for k in range(moved.shape[3]):
                    for j in range(4):
                        by_source[i, source, k] += by_point[j] * moved[source, point, j, k]
                by_coat[i, source, 0] -= 0.5 * np.log(square) * shining * reflected
                for j in range(1, 6):
                    by_coat[i, source, j] += shining * shine[3 + j]
                by_coat[i, source, 6] += (1.0 - up) / tilted * shining * reflected
                by_coat[i, source, 7] += power * (facing - 1.0) * reflected
                between_change = l0 * c0 + l1 * c1 + l2 * c2
                by_coat[i, source, 8] += shining * (by_between * between_change + shine[3] * seen_change)
                by_coat[i, source, 9] += shining * shine[9]
            for k in range(turned.shape[2]):
                for j in range(3):
                    by_source[i, source, k] += by_axis[j] * turned[source, j, k]


@njit(cache=True, error_model="numpy")
def to_camera_change(camera: Any, x: Any, y: Any, z: Any) -> Any:
    """Return the derivative of `to_camera` by one over the camera's height."""
    v0, v1, v2 = to_camera(camera, x, y, z)
    along = -(v0 * x + v1 * y + v2 * z)
    length = np.sqrt((camera * x) ** 2 + (camera * y) ** 2 + (1.0 - camera * z) ** 2)
    return (-x - along * v0) / length, (-y - along * v1) / length, (-z - along * v2) / length


@njit(cache=True, error_model="numpy")
def write_reflected(lit: Any, seen: Any, between: Any, coat: Any, out: Any) -> None:
    """Write the reflected share of a ray, and its derivatives.

    The derivatives are by `lit`, `between` and `seen`, and by the coat's numbers 1 to 5 and 9.

    lit, seen, between, coat : see `kernels.reflected`
    """
    even, uneven, gloss, narrow, tail, scattering = coat[1], coat[2], coat[3], coat[4], coat[5], coat[9]
    excess, largest = between - lit * seen, max(max(lit, seen), GRAZING)
    together = max(excess, 0.0) / largest
    steeper = -(seen + (excess / largest if lit >= largest else 0.0)) / largest if excess > 0.0 else 0.0
    rough = lit * (even + uneven * together)
    rough_by_lit = even + uneven * (together + lit * steeper)
    rough_by_between = lit * uneven / largest if excess > 0.0 else 0.0
    rough_by_seen = -lit * uneven * (lit + (excess / largest if seen > lit else 0.0)) / largest if excess > 0.0 else 0.0
    both, unscattered = lit + seen, 1.0 - scattering
    scattered = 2.0 * lit / both
    matt = unscattered * rough + scattering * scattered
    matt_by_lit = unscattered * rough_by_lit + scattering * 2.0 * seen / (both * both)
    matt_by_seen = unscattered * rough_by_seen - scattering * 2.0 * lit / (both * both)

    wide = np.sqrt(2.0 + 2.0 * between)
    half = min((lit + seen) / wide, 1.0)
    half_by_lit, half_by_between = (1.0 / wide, -half / (wide * wide)) if half < 1.0 else (0.0, 0.0)
    ratio = 2.0 * (1.0 / narrow - 1.0) / tail
    off = (1.0 - half * half) * ratio
    facets = (1.0 + off) ** -tail / (np.pi * narrow)
    by_off = -tail / (1.0 + off)
    root_lit = np.sqrt(narrow + (1.0 - narrow) * lit * lit)
    root_seen = np.sqrt(narrow + (1.0 - narrow) * seen * seen)
    whole_lit, whole_seen = lit + root_lit + 1e-9, seen + root_seen + 1e-9
    masked_seen = 0.5 / whole_seen
    lobe = facets * masked_seen
    shining = lobe * 2.0 * lit / whole_lit
    shining_by_half = -2.0 * half * ratio * by_off * shining
    unmasking = 2.0 / whole_lit - 2.0 * lit / whole_lit**2 * (1.0 + (1.0 - narrow) * lit / root_lit)
    unmasking_seen = -(1.0 + (1.0 - narrow) * seen / root_seen) / whole_seen
    by_narrow = -by_off * 2.0 * (1.0 - half * half) / (narrow * narrow * tail) - 1.0 / narrow
    by_narrow -= 0.5 * (1.0 - lit * lit) / (root_lit * whole_lit)
    by_narrow -= 0.5 * (1.0 - seen * seen) / (root_seen * whole_seen)

    out[0] = (1.0 - gloss) * matt + gloss * shining
    out[1] = (1.0 - gloss) * matt_by_lit + gloss * (shining_by_half * half_by_lit + lobe * unmasking)
    out[2] = (1.0 - gloss) * unscattered * rough_by_between + gloss * shining_by_half * half_by_between
    out[3] = (1.0 - gloss) * matt_by_seen + gloss * (shining_by_half * half_by_lit + shining * unmasking_seen)
    out[4] = (1.0 - gloss) * unscattered * lit
    out[5] = (1.0 - gloss) * unscattered * lit * together
    out[6] = shining - matt
    out[7] = gloss * by_narrow * shining
    out[8] = gloss * shining * (-np.log(1.0 + off) - by_off * off / tail)
    out[9] = (1.0 - gloss) * (scattered - rough)


# Numbers of a light model that a bundle adjustment searches for, and what they may be.

COAT: Final = ("fall_off", "roughness", "gloss", "log_width", "log_tail", "tilt_gain", "beam", "camera", "scattering")
COAT_START: Final = np.array([2.0, 0.3, 0.1, np.log(0.35), np.log(2.0), 0.0, 0.2, 0.3, 0.1])
COAT_SIGMA: Final = np.array([1.0, 0.5, 0.3, 0.5, 1.0, 0.15, 0.5, 0.3, 0.3])
_COAT_LOW: Final = np.array([0.0, 0.0, 0.0, np.log(0.08), 0.0, -0.9, 0.0, 0.0, 0.0])
_COAT_HIGH: Final = np.array([4.0, 1.0, 0.95, np.log(0.8), np.log(60.0), 2.0, 1.0, 4.0, 1.0])
_LOW_UP: Final = np.log(0.04)
_HIGH_UP: Final = np.log(5.0)
_FARTHEST: Final = 4.0
_LARGEST: Final = (2.0, 1.6)
"""Bounds of the places of sources, and of their length and height."""


@dataclass(frozen=True, slots=True, eq=False)
class Numbers:
    """Numbers of a model with S sources and C channels, and of B balls.

    place, extent : of sources, shape (S, 3) with the logarithm of the height, and (S, 2), length and height
    strength, haze, albedo : see `LightModel`, shape (C, S), (C,) and (1,)
    coat : numbers of the coat, in the order of `COAT`
    shift : of the balls' centres, column and row, pixels, shape (B, 2)
    residual : shape (C, terms * places)
    """

    place: Float64Array
    extent: Float64Array
    strength: Float64Array
    haze: Float64Array
    albedo: Float64Array
    coat: Float64Array
    shift: Float64Array
    residual: Float64Array

    def packed(self) -> Float64Array:
        """Return all numbers in their order."""
        return np.concatenate([np.ravel(getattr(self, one.name)) for one in fields(self)])

    def unpacked(self, values: Float64Array) -> Numbers:
        """Return numbers with other values, kept within what a sensor can have."""
        found, at = {}, 0
        for one in fields(self):
            own = getattr(self, one.name)
            found[one.name] = values[at : at + own.size].reshape(own.shape).copy()
            at += own.size
        np.clip(found["place"][:, :2], -_FARTHEST, _FARTHEST, out=found["place"][:, :2])
        np.clip(found["place"][:, 2], _LOW_UP, _HIGH_UP, out=found["place"][:, 2])
        np.clip(found["extent"], 0.0, _LARGEST, out=found["extent"])
        np.clip(found["coat"], _COAT_LOW, _COAT_HIGH, out=found["coat"])
        for name in ("strength", "haze", "albedo"):
            np.maximum(found[name], 0.0, out=found[name])
        return Numbers(**found)

    @property
    def sources(self) -> Float64Array:
        """Sources see `LightModel`."""
        return np.concatenate([self.place[:, :2], np.exp(self.place[:, 2:]), self.extent], axis=1)

    @property
    def coat_change(self) -> Float64Array:
        """Derivatives of `LightModel.coat` by the coat's numbers: shape (10, 9)."""
        roughness, width, tail = self.coat[1], np.exp(2.0 * self.coat[3]), np.exp(self.coat[4])
        square = roughness**2
        change = np.zeros((len(self.coat) + 1, len(self.coat)))
        change[0, 0] = change[3, 2] = change[6, 5] = change[7, 6] = change[8, 7] = change[9, 8] = 1.0
        change[1, 1] = -0.33 * roughness / (square + 0.33) ** 2
        change[2, 1] = 0.081 * roughness / (square + 0.09) ** 2
        change[4, 3], change[5, 4] = 2.0 * width, tail
        return change


@dataclass(frozen=True, slots=True, eq=False)
class Jacobian:
    """Derivatives of the intensity of samples (N,) in channels (C,), and its weighted errors.

    shared : by numbers that all channels share, or of one channel, shape (N, C, K)
    by_shift : by the shift of each sample's ball, shape (N, C, 2); other balls' shifts change nothing
    ball, balls : number of each sample's ball, shape (N,), and number of all balls
    features : by the residual's coefficients of any channel, shape (N, F)
    error, weight : of the predicted intensity, shape (N, C)
    """

    shared: Float64Array
    by_shift: Float64Array
    ball: NDArray[np.intp]
    balls: int
    features: Float64Array
    error: Float64Array
    weight: Float64Array

    def normal_equations(self, rows: MaskArray | slice) -> tuple[Float64Array, Float64Array]:
        """Return the system and the gradient of some rows: shared numbers, shifts, coefficients of each channel."""
        from scipy.sparse import csr_array  # here, because reading a calibration fits nothing

        shared, own, channels = self.shared.shape[-1], self.features.shape[1], self.error.shape[1]
        shifts = shared + np.arange(2 * self.balls)
        system = np.zeros((shared + len(shifts) + channels * own,) * 2)
        gradient = np.zeros(len(system))
        ball, features = self.ball[rows], self.features[rows]
        column, begin = (2 * ball[:, None] + np.arange(2)).ravel(), 2 * np.arange(len(ball) + 1)
        for channel in range(channels):
            others = np.append(np.arange(shared), shared + len(shifts) + channel * own + np.arange(own))
            root = np.sqrt(self.weight[rows, channel])
            error = root * self.error[rows, channel]
            by_others = root[:, None] * np.concatenate([self.shared[rows, channel], features], axis=1)
            entries = (root[:, None] * self.by_shift[rows, channel]).ravel()
            by_shifts = csr_array((entries, column, begin), (len(ball), len(shifts)))
            crossed = by_shifts.T @ by_others
            system[np.ix_(others, others)] += by_others.T @ by_others
            system[np.ix_(shifts, others)] += crossed
            system[np.ix_(others, shifts)] += crossed.T
            system[np.ix_(shifts, shifts)] += (by_shifts.T @ by_shifts).toarray()
            gradient[others] += by_others.T @ error
            gradient[shifts] += by_shifts.T @ error
        return system, gradient
