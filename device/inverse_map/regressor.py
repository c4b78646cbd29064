"""A curve from colour and place to slope: monomials and waves of colour, each coefficient a polynomial in position."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from device.errors import RecordError
from device.inverse_map.polynomial_features import (
    FeatureScaler,
    RandomFourierFeatures,
    blocks_of,
    colour_exponents,
    monomial_rows,
    monomials,
    position_exponents,
    sum_of_products,
)
from device.surface.fields import Float32Array, Float64Array

MAX_COLOUR_DEGREE: Final = 8
MAX_POSITION_DEGREE: Final = 2
"""No curve has a higher degree; a file that asks for one is not read."""


@dataclass(frozen=True, slots=True, eq=False)
class FeatureRegressor:
    """A fitted curve.

    colours : the colour space whose variables it is a function of
    colour_degree, position_degree : its degrees
    coefficients : float32 array of shape (M, K, 2), M colour monomials and then waves, K position monomials
    waves : its waves of colour, none where it is a polynomial
    """

    colours: FeatureScaler
    colour_degree: int
    position_degree: int
    coefficients: Float32Array
    waves: RandomFourierFeatures = field(default_factory=RandomFourierFeatures.none)

    def rows(self, values: Float32Array, across: Float32Array, down: Float32Array) -> tuple[Float32Array, Float32Array]:
        """Return the stereographic slope (h, w, 2) and excess (h, w) of whole rows of colours (h, w, 3).

        across, down : float32 arrays of shape (w,) and (h,), position variables of columns and rows
        """
        height, width, _ = values.shape
        variables, excess = self.colours.variables(values.reshape(-1, 3))
        terms = colour_terms(variables, self.colour_degree, self.waves)
        per_position = (terms @ self.coefficients.reshape(terms.shape[1], -1)).reshape(height, width, -1, 2)
        u = np.zeros((height, width, 2), np.float32)
        for term, (i, j) in enumerate(position_exponents(self.position_degree)):
            u += per_position[:, :, term] * (across[None, :, None] ** i * down[:, None, None] ** j)
        return u, excess.reshape(height, width)

    def at(self, values: Float32Array, place: Float64Array) -> Float64Array:
        """Return the stereographic slopes (N, 2) of colours (N, 3) at position variables (N, 2)."""
        u = np.empty((len(place), 2))
        coefficients = self.coefficients.astype(np.float64)
        for part in blocks_of(len(place)):
            variables, _ = self.colours.variables(values[part])
            terms = colour_rows(variables.astype(np.float64).T, self.colour_degree, self.waves)
            u[part] = sum_of_products(terms, monomial_rows(place[part].T, self.position_degree), coefficients)
        return u

    def design(self, values: Float32Array, place: Float64Array) -> Float64Array:
        """Its features (N, M K) for colours (N, 3) at position variables (N, 2); see `design_matrix`."""
        return design_matrix(self.colours, self.colour_degree, self.position_degree, values, place, self.waves)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return everything as arrays; `from_arrays` is its inverse."""
        named = {f"colour_{name}": array for name, array in self.colours.arrays().items()}
        named |= {f"wave_{name}": array for name, array in self.waves.arrays().items()}
        return named | {
            "degrees": np.array([self.colour_degree, self.position_degree]),
            "coefficients": self.coefficients,
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]], source: str, *, linear: bool = False) -> FeatureRegressor:
        """Return the curve that `arrays` wrote; KeyError or ValueError when malformed.

        source : the file, for errors
        linear : whether its colour space takes colours as they are

        Raises
        ------
        RecordError
            Its degrees or its number of coefficients are none that a curve has.
        """
        colours = FeatureScaler.from_arrays(with_prefix(arrays, "colour_"), linear=linear)
        colour_degree, position_degree = (int(degree) for degree in arrays["degrees"])
        coefficients = np.asarray(arrays["coefficients"], np.float32)
        if not (0 <= colour_degree <= MAX_COLOUR_DEGREE and 0 <= position_degree <= MAX_POSITION_DEGREE):
            raise RecordError(f"{source}: degrees {colour_degree} and {position_degree}, which no map has")
        waves = RandomFourierFeatures.from_arrays(with_prefix(arrays, "wave_"))
        expected = (len(colour_exponents(colour_degree)) + waves.count, len(position_exponents(position_degree)), 2)
        if coefficients.shape != expected:
            raise RecordError(f"{source}: coefficients of shape {coefficients.shape}, not {expected}: calibrate again")
        return cls(colours, colour_degree, position_degree, coefficients, waves)


def design_matrix(
    colours: FeatureScaler,
    colour_degree: int,
    position_degree: int,
    values: Float32Array,
    place: Float64Array,
    waves: RandomFourierFeatures,
) -> Float64Array:
    """Return every term of colour times every position monomial: float64 array of shape (N, M K).

    values : float32 array of shape (N, 3), colours
    place : float64 array of shape (N, 2), position variables
    """
    variables, _ = colours.variables(values)
    by_colour = colour_terms(variables.astype(np.float64), colour_degree, waves)
    by_place = monomials(place, position_degree)
    return np.asarray((by_colour[:, :, None] * by_place[:, None, :]).reshape(len(place), -1))


def colour_terms(variables: NDArray[Any], degree: int, waves: RandomFourierFeatures) -> NDArray[Any]:
    """Return monomials up to `degree` and then waves of colours' variables (N, 3): array (N, M) of their type."""
    terms = monomials(variables, degree)
    return np.concatenate([terms, waves.values(variables)], axis=-1) if waves.count else terms


def colour_rows(variables: NDArray[Any], degree: int, waves: RandomFourierFeatures) -> NDArray[Any]:
    """Return the same with every term in a row: shape (M, N), from variables of shape (3, N)."""
    terms = monomial_rows(variables, degree)
    return np.concatenate([terms, waves.values(variables.T).T]) if waves.count else terms


def with_prefix(arrays: Mapping[str, NDArray[Any]], prefix: str) -> dict[str, NDArray[Any]]:
    """Return the arrays whose name begins with `prefix`, without it."""
    return {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}
