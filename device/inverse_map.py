"""The position-aware inverse map: from intensity and place in the field straight to slope.

Near lights make the reflectance change over the field, so that one colour means different slopes in different places.
The map is a polynomial in log intensity whose every coefficient is itself a polynomial in position. It predicts the
stereographic slope.

Why a direct inverse: held-out balls prefer it to every inversion of a forward model that was tried
(docs/decisions/0004-direct-inverse.md).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from device.colour_domain import ColourDomain
from device.colour_space import ColourSpace
from device.errors import CalibrationMismatch, RecordError
from device.photometry import IntensityImage
from device.polynomials import colour_exponents, field_position, monomials, position_exponents
from device.stereographic import slope_from_stereographic
from device.surface import Float32Array, Float64Array, GradientField

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
class InverseMap:
    """The fitted map.

    shape : (H, W) of the full-size field that positions are scaled by
    colours : the colour space
    domain : the colours that the balls showed
    colour_degree, position_degree : degrees of the polynomial
    coefficients : float32 array of shape (M, K, 2), M colour monomials, K position monomials
    steepest : slope up to which the balls taught it; what lies beyond is extrapolated
    """

    shape: tuple[int, int]
    colours: ColourSpace
    domain: ColourDomain
    colour_degree: int
    position_degree: int
    coefficients: Float32Array
    steepest: float

    def check_size(self, shape: tuple[int, int], binning: int = 1) -> None:
        """Refuse an image that is not of this field's size divided by `binning`.

        Raises
        ------
        CalibrationMismatch
            Says both sizes.
        """
        expected = (self.shape[0] // binning, self.shape[1] // binning)
        if shape != expected:
            raise CalibrationMismatch(
                f"the frame is {shape[1]}x{shape[0]} pixels but its calibration is for "
                f"{expected[1]}x{expected[0]}: use the calibration of this camera mode"
            )

    def gradients(self, image: IntensityImage, binning: int = 1) -> GradientField:
        """Slope, validity and relative confidence of every pixel of an image binned by `binning`.

        Raises
        ------
        CalibrationMismatch
            The image is not this field's size divided by `binning`.
        """
        self.check_size(image.shape, binning)
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
        place = field_position(column.astype(np.float64), row.astype(np.float64), self.shape)
        design = design_matrix(self.colours, self.colour_degree, self.position_degree, intensity, place)
        return slope_from_stereographic(design @ self.coefficients.reshape(-1, 2).astype(np.float64))

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Everything as arrays, for an npz file; `from_arrays` is its inverse."""
        parts = (("colour", self.colours), ("domain", self.domain))
        named = {f"{part}_{name}": array for part, owner in parts for name, array in owner.arrays().items()}
        return named | {
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
            colours = ColourSpace.from_arrays(_with_prefix(arrays, "colour_"))
            domain = ColourDomain.from_arrays(_with_prefix(arrays, "domain_"))
            rows, columns = (int(size) for size in arrays["shape"])
            colour_degree, position_degree = (int(degree) for degree in arrays["degrees"])
            coefficients = np.asarray(arrays["coefficients"], np.float32)
            steepest = float(arrays["steepest"])
        except (KeyError, IndexError, ValueError, TypeError) as error:
            raise RecordError(f"{source} holds no inverse map ({error}): calibrate again") from error
        if not (0 <= colour_degree <= MOST_DEGREE and 0 <= position_degree <= MOST_DEGREE):
            raise RecordError(f"{source}: degrees {colour_degree} and {position_degree}, which no map has")
        expected = (len(colour_exponents(colour_degree)), len(position_exponents(position_degree)), 2)
        if coefficients.shape != expected:
            raise RecordError(f"{source}: coefficients of shape {coefficients.shape}, not {expected}: calibrate again")
        return cls((rows, columns), colours, domain, colour_degree, position_degree, coefficients, steepest)


def design_matrix(
    colours: ColourSpace, colour_degree: int, position_degree: int, intensity: Float32Array, place: Float64Array
) -> Float64Array:
    """Every colour monomial times every position monomial: float64 array of shape (N, M K).

    place : float64 array of shape (N, 2), position variables
    """
    variables, _ = colours.variables(intensity)
    by_colour = monomials(variables.astype(np.float64), colour_degree)
    by_place = monomials(place, position_degree)
    return np.asarray((by_colour[:, :, None] * by_place[:, None, :]).reshape(len(place), -1))


def _with_prefix(arrays: Mapping[str, NDArray[Any]], prefix: str) -> dict[str, NDArray[Any]]:
    return {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}


def _blocks(rows: int) -> Iterator[slice]:
    for start in range(0, rows, _BLOCK_ROWS):
        yield slice(start, min(start + _BLOCK_ROWS, rows))
