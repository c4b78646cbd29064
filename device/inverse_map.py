"""The position-aware inverse map: from intensity and place in the field straight to slope.

Near lights make the reflectance change over the field, so that one colour means different slopes in different places.
The map is a polynomial in log intensity whose every coefficient is itself a polynomial in position. It predicts the
stereographic slope u = 2 (p, q) / (1 + sqrt(1 + p² + q²)), which stays bounded where slopes grow.

Why a direct inverse: held-out balls prefer it to every inversion of a forward model that was tried
(docs/decisions/0004-direct-inverse.md).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from device.errors import CalibrationMismatch, RecordError
from device.photometry import IntensityImage
from device.surface import Float32Array, Float64Array, GradientField

LOG_OFFSET: Final = 0.05
"""Added to intensity before the logarithm: about the darkest shade that still carries slope."""

TRUSTED_EXCESS: Final = 0.5
"""Distance outside the calibrated colours, in standard deviations, at which confidence has fallen to a quarter."""

CLIPPED_CONFIDENCE: Final = 0.03
"""Confidence in the slope of a pixel with a saturated channel: its neighbours decide, yet no hole is torn."""

LOST_EXCESS: Final = 6.0
"""Distance outside the calibrated colours, in standard deviations, from which a slope means nothing."""

MOST_DEGREE: Final = 16
"""No map has polynomials of a higher degree; a file that asks for one is not read."""

_BLOCK_ROWS: Final = 64


@dataclass(frozen=True, slots=True, eq=False)
class ColourSpace:
    """How intensity becomes the polynomial's variable: logarithm, clip to what the balls showed, centre, scale.

    centre, scale, low, high : float32 arrays of shape (3,), of log intensity
    """

    centre: Float32Array
    scale: Float32Array
    low: Float32Array
    high: Float32Array

    @classmethod
    def observed(cls, intensity: Float32Array) -> ColourSpace:
        """The space of the observed intensities, array of shape (N, 3)."""
        logs = log_intensity(intensity)
        low, high = np.percentile(logs, [0.05, 99.95], axis=0)
        fields = (logs.mean(axis=0), 2.0 * logs.std(axis=0), low, high)
        return cls(*(field.astype(np.float32) for field in fields))

    def variables(self, intensity: Float32Array) -> tuple[Float32Array, Float32Array]:
        """Polynomial variables (N, 3), and how far (N,) each pixel lay outside the range, in standard deviations."""
        logs = log_intensity(intensity)
        clipped = np.clip(logs, self.low, self.high)
        excess = np.abs(logs - clipped).max(axis=-1)
        spread = np.float32(0.5) * self.scale.mean()
        return (clipped - self.centre) / self.scale, excess / spread


def log_intensity(intensity: Float32Array) -> Float32Array:
    """log(I + LOG_OFFSET), of the shape of `intensity`."""
    return np.log(np.maximum(intensity, 0.0) + np.float32(LOG_OFFSET))


def colour_exponents(degree: int) -> list[tuple[int, int, int]]:
    """Exponents of the monomials of three colours up to a total degree."""
    return [(i, j, k) for i, j, k in product(range(degree + 1), repeat=3) if i + j + k <= degree]


def position_exponents(degree: int) -> list[tuple[int, int]]:
    """Exponents of the monomials of the two position variables up to a total degree."""
    return [(i, j) for i, j in product(range(degree + 1), repeat=2) if i + j <= degree]


def monomials(variables: NDArray[Any], degree: int) -> NDArray[Any]:
    """Monomials of shape (N, M) of variables of shape (N, D), D 2 or 3, ordered as the exponents."""
    exponents = colour_exponents(degree) if variables.shape[1] == 3 else position_exponents(degree)
    columns: dict[tuple[int, ...], NDArray[Any]] = {(0,) * variables.shape[1]: np.ones_like(variables[:, 0])}
    for exponent in exponents:
        if exponent in columns:
            continue
        axis = next(i for i, power in enumerate(exponent) if power)
        lower = tuple(power - (i == axis) for i, power in enumerate(exponent))
        columns[exponent] = columns[lower] * variables[:, axis]
    return np.stack([columns[exponent] for exponent in exponents], axis=-1)


def field_position(column: NDArray[Any], row: NDArray[Any], shape: tuple[int, int]) -> NDArray[Any]:
    """Position variables (N, 2), -1 to 1 over a field of `shape` (H, W), from full-size pixel coordinates."""
    rows, columns = shape
    return np.stack([(2.0 * column + 1.0) / columns - 1.0, (2.0 * row + 1.0) / rows - 1.0], axis=-1)


def slope_from_stereographic(u: NDArray[Any]) -> NDArray[Any]:
    """(p, q) of shape (..., 2) from stereographic slopes; |u| is held below 1.9 (slope 19.5)."""
    square = np.minimum((u * u).sum(axis=-1, keepdims=True), 3.61)
    return np.asarray(u / (1.0 - 0.25 * square))


def stereographic_from_slope(p: NDArray[Any], q: NDArray[Any]) -> NDArray[Any]:
    """Stereographic slopes of shape (N, 2)."""
    scale = 2.0 / (1.0 + np.sqrt(1.0 + p * p + q * q))
    return np.asarray(np.stack([p, q], axis=-1) * scale[..., None])


@dataclass(frozen=True, slots=True, eq=False)
class InverseMap:
    """The fitted map.

    shape : (H, W) of the full-size field that positions are scaled by
    colours : the colour space
    colour_degree, position_degree : degrees of the polynomial
    coefficients : float32 array of shape (M, K, 2), M colour monomials, K position monomials
    steepest : slope up to which the balls taught it; what lies beyond is extrapolated
    """

    shape: tuple[int, int]
    colours: ColourSpace
    colour_degree: int
    position_degree: int
    coefficients: Float32Array
    steepest: float

    def gradients(self, image: IntensityImage, binning: int = 1) -> GradientField:
        """Slope, validity and relative confidence of every pixel of an image binned by `binning`.

        Raises
        ------
        CalibrationMismatch
            The image is not this field's size divided by `binning`.
        """
        expected = (self.shape[0] // binning, self.shape[1] // binning)
        if image.shape != expected:
            raise CalibrationMismatch(
                f"the frame is {image.shape[1]}x{image.shape[0]} pixels but its calibration is for "
                f"{expected[1]}x{expected[0]}: use the calibration of this camera mode"
            )
        p, q, excess = (np.empty(image.shape, np.float32) for _ in range(3))
        for rows in _blocks(image.shape[0]):
            p[rows], q[rows], excess[rows] = self._block(image.values[rows], rows, binning)
        valid = image.valid & (excess < LOST_EXCESS)
        confidence = np.where(image.clipped, CLIPPED_CONFIDENCE, 1.0) / (1.0 + (excess / TRUSTED_EXCESS) ** 2) ** 2
        weight = np.where(valid, confidence, 0.0).astype(np.float32)
        return GradientField(p, q, valid, weight)

    def _block(
        self, values: Float32Array, rows: slice, binning: int
    ) -> tuple[Float32Array, Float32Array, Float32Array]:
        height, width, _ = values.shape
        variables, excess = self.colours.variables(values.reshape(-1, 3))
        terms = monomials(variables, self.colour_degree)
        flat = self.coefficients.reshape(terms.shape[1], -1)
        per_position = (terms @ flat).reshape(height, width, -1, 2)
        centre = 0.5 * (binning - 1)
        column = np.arange(width) * binning + centre
        row = np.arange(rows.start, rows.start + height) * binning + centre
        u = np.zeros((height, width, 2), np.float32)
        across = field_position(column, np.zeros_like(column), self.shape)[:, 0].astype(np.float32)
        down = field_position(np.zeros_like(row), row, self.shape)[:, 1].astype(np.float32)
        for term, (i, j) in enumerate(position_exponents(self.position_degree)):
            u += per_position[:, :, term] * (across[None, :, None] ** i * down[:, None, None] ** j)
        slope = slope_from_stereographic(u)
        return slope[..., 0], slope[..., 1], excess.reshape(height, width)

    def predict(self, intensity: Float32Array, column: Float32Array, row: Float32Array) -> Float64Array:
        """Slopes of shape (N, 2) for intensities of shape (N, 3) at full-size pixel coordinates."""
        design = design_matrix(
            self.colours, self.colour_degree, self.position_degree, self.shape, intensity, column, row
        )
        return slope_from_stereographic(design @ self.coefficients.reshape(-1, 2).astype(np.float64))

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Everything as arrays, for an npz file; `from_arrays` is its inverse."""
        colours = {f"colour_{name}": getattr(self.colours, name) for name in ("centre", "scale", "low", "high")}
        return colours | {
            "shape": np.array(self.shape),
            "degrees": np.array([self.colour_degree, self.position_degree]),
            "coefficients": self.coefficients,
            "steepest": np.array(self.steepest),
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]], source: str) -> InverseMap:
        """The map that `arrays` wrote; `source` names the file in errors.

        Raises
        ------
        RecordError
            An array is missing or of another shape.
        """
        try:
            colours = ColourSpace(*(arrays[f"colour_{name}"] for name in ("centre", "scale", "low", "high")))
            rows, columns = (int(size) for size in arrays["shape"])
            colour_degree, position_degree = (int(degree) for degree in arrays["degrees"])
            coefficients = arrays["coefficients"]
            steepest = float(arrays["steepest"])
        except (KeyError, ValueError) as error:
            raise RecordError(f"{source} holds no inverse map ({error}): calibrate again") from error
        if not (0 <= colour_degree <= MOST_DEGREE and 0 <= position_degree <= MOST_DEGREE):
            raise RecordError(f"{source}: degrees {colour_degree} and {position_degree} are no map's: calibrate again")
        expected = (len(colour_exponents(colour_degree)), len(position_exponents(position_degree)), 2)
        if coefficients.shape != expected:
            raise RecordError(f"{source}: coefficients of shape {coefficients.shape}, not {expected}: calibrate again")
        return cls((rows, columns), colours, colour_degree, position_degree, coefficients, steepest)


def design_matrix(
    colours: ColourSpace,
    colour_degree: int,
    position_degree: int,
    shape: tuple[int, int],
    intensity: Float32Array,
    column: Float32Array,
    row: Float32Array,
) -> Float64Array:
    """Every colour monomial times every position monomial: float64 array of shape (N, M K)."""
    variables, _ = colours.variables(intensity)
    by_colour = monomials(variables.astype(np.float64), colour_degree)
    place = field_position(column.astype(np.float64), row.astype(np.float64), shape)
    by_place = monomials(place, position_degree)
    return np.asarray((by_colour[:, :, None] * by_place[:, None, :]).reshape(len(column), -1))


def _blocks(rows: int) -> Iterator[slice]:
    for start in range(0, rows, _BLOCK_ROWS):
        yield slice(start, min(start + _BLOCK_ROWS, rows))
