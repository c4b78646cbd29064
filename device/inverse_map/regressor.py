"""A curve from colour and place to slope: monomials and waves of colour, each coefficient a polynomial in position."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from itertools import product
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from device.errors import RecordError
from device.surface import Float32Array, Float64Array


def colour_exponents(degree: int) -> list[tuple[int, int, int]]:
    """Return exponents of the monomials of three colours up to a total degree."""
    return [(i, j, k) for i, j, k in product(range(degree + 1), repeat=3) if i + j + k <= degree]


def position_exponents(degree: int) -> list[tuple[int, int]]:
    """Return exponents of the monomials of the two position variables up to a total degree."""
    return [(i, j) for i, j in product(range(degree + 1), repeat=2) if i + j <= degree]


def monomials(variables: NDArray[Any], degree: int) -> NDArray[Any]:
    """Return monomials of shape (N, M) of variables of shape (N, D), D 2 or 3, ordered as the exponents."""
    return np.ascontiguousarray(monomial_rows(variables.T, degree).T)


def monomial_rows(variables: NDArray[Any], degree: int) -> NDArray[Any]:
    """Return the monomials with each in a row: shape (M, N), from variables of shape (D, N)."""
    steps, factors = _steps(degree, len(variables)), np.ascontiguousarray(variables)
    rows = np.empty((len(steps) + 1, factors.shape[1]), factors.dtype)
    rows[0] = 1.0
    for row, (lower, axis) in enumerate(steps, start=1):
        np.multiply(rows[lower], factors[axis], out=rows[row])
    return rows


def sum_of_products(terms: NDArray[Any], place_monomials: NDArray[Any], coefficients: NDArray[Any]) -> NDArray[Any]:
    """Return the sum over all terms (M, N) times place monomials (K, N) with coefficients (M, K, C): shape (N, C)."""
    places, columns = coefficients.shape[1:]
    by_place = (terms.T @ coefficients.reshape(len(terms), -1)).reshape(-1, places, columns)
    found = by_place[:, 0] * place_monomials[0][:, None]
    for number in range(1, places):
        found += by_place[:, number] * place_monomials[number][:, None]
    return np.asarray(found)


def blocks_of(count: int, size: int = 4096) -> Iterator[slice]:
    """Yield slices of at most `size` pixels, whose terms stay in the processor's cache."""
    for start in range(0, count, size):
        yield slice(start, min(start + size, count))


@cache
def _steps(degree: int, variables: int) -> list[tuple[int, int]]:
    """Return the monomial and the variable whose product each monomial is, without the constant."""
    exponents: list[tuple[int, ...]] = [*(colour_exponents(degree) if variables == 3 else position_exponents(degree))]
    number = {exponent: at for at, exponent in enumerate(exponents)}
    steps = []
    for exponent in exponents[1:]:
        axis = next(i for i, power in enumerate(exponent) if power)
        steps.append((number[tuple(power - (i == axis) for i, power in enumerate(exponent))], axis))
    return steps


def field_position(column: NDArray[Any], row: NDArray[Any], shape: tuple[int, int]) -> NDArray[Any]:
    """Return the position variables (N, 2) of full-size pixel coordinates: -1 to 1 over the field.

    shape : of the field, (H, W)
    """
    rows, columns = shape
    return np.stack([(2.0 * column + 1.0) / columns - 1.0, (2.0 * row + 1.0) / rows - 1.0], axis=-1)


# Cosines of colour: terms of an inverse map that bend in one place without bending everywhere.
#
# A skin whose metal flakes shine in a narrow lobe answers a small tilt with a large change of colour near flat and with
# a small one farther off. A polynomial that follows it there runs away elsewhere. A sum of cosines of random direction
# and phase is the smooth function of a Gaussian process: it bends over a stated length and nowhere runs away (Rahimi &
# Recht, "Random features for large-scale kernel machines", 2007).

WAVES: Final = 64
"""Cosines of a curve that has any."""

BEND_LENGTH: Final = 0.5
"""Over which a sum of them bends, in a colour space's variables: one standard deviation of the balls' colours."""

AMPLITUDE: Final = 1.5
"""Root mean square of a sum of all waves with coefficients of one: how cheap they are beside monomials."""

MAX_WAVES: Final = 1000
"""No curve has more; a file that asks for more is not read."""


@dataclass(frozen=True, slots=True, eq=False)
class RandomFourierFeatures:
    """Cosines a cos(k·v + φ) of a colour's variables v.

    direction : float32 array of shape (3, W), k in radians per variable
    phase : float32 array of shape (W,), φ in radians
    """

    direction: Float32Array
    phase: Float32Array

    @classmethod
    def sample(cls, seed: int = 1) -> RandomFourierFeatures:
        """Return `WAVES` waves whose sums bend over `BEND_LENGTH`; the same ones each time."""
        random = np.random.default_rng(seed)
        direction = random.standard_normal((3, WAVES)) / BEND_LENGTH
        return cls(direction.astype(np.float32), random.uniform(0.0, 2.0 * np.pi, WAVES).astype(np.float32))

    @classmethod
    def none(cls) -> RandomFourierFeatures:
        """Return no wave: the curve is a polynomial."""
        return cls(np.zeros((3, 0), np.float32), np.zeros(0, np.float32))

    @property
    def count(self) -> int:
        """Number of features."""
        return self.phase.size

    @property
    def amplitude(self) -> float:
        """Amplitude of each wave; 0 without waves."""
        return AMPLITUDE * float(np.sqrt(2.0 / self.count)) if self.count else 0.0

    def values(self, variables: NDArray[Any]) -> NDArray[Any]:
        """Return the waves at colours' variables of shape (N, 3): array of shape (N, W) of the same type."""
        kind = variables.dtype
        angle = variables @ self.direction.astype(kind) + self.phase.astype(kind)
        return np.asarray(kind.type(self.amplitude) * np.cos(angle))

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return everything as arrays, nothing where there is no wave; `from_arrays` is its inverse."""
        return {"direction": self.direction, "phase": self.phase} if self.count else {}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> RandomFourierFeatures:
        """Return the waves that `arrays` wrote; KeyError or ValueError when malformed."""
        if not arrays:
            return cls.none()
        direction, phase = (np.asarray(arrays[name], np.float32) for name in ("direction", "phase"))
        fits = phase.ndim == 1 and direction.shape == (3, phase.size) and 0 < phase.size <= MAX_WAVES
        if not fits or not (np.isfinite(direction).all() and np.isfinite(phase).all()):
            raise ValueError(f"waves of shape {direction.shape} and {phase.shape}")
        return cls(direction, phase)


# Colour as variables of a polynomial: its logarithm or itself, clipped to the balls' range and scaled.

DARK_OFFSET: Final = 0.05
"""Added to intensity before the logarithm: about the darkest shade that still carries slope."""

RANGE_PERCENT: Final = (0.05, 99.95)
"""Percentiles of the observed colours that variables are clipped to: a polynomial runs away outside."""


def log_intensity(intensity: Float32Array) -> Float32Array:
    """log(I + DARK_OFFSET), of the shape of `intensity`."""
    return np.log(np.maximum(intensity, np.float32(0.0)) + np.float32(DARK_OFFSET))


@dataclass(frozen=True, slots=True, eq=False)
class FeatureScaler:
    """A clip to what the balls showed, a centre and a scale.

    centre, scale, low, high : float32 arrays of shape (3,), of log intensity, or of colours themselves where `linear`
    linear : whether colours are taken as they are
    """

    centre: Float32Array
    scale: Float32Array
    low: Float32Array
    high: Float32Array
    linear: bool = False

    @classmethod
    def observed(cls, colours: Float32Array, *, linear: bool = False) -> FeatureScaler:
        """Return the space of the observed colours, array of shape (N, 3)."""
        seen = colours if linear else log_intensity(colours)
        low, high = np.percentile(seen, RANGE_PERCENT, axis=0)
        fields = (seen.mean(axis=0), np.maximum(2.0 * seen.std(axis=0), 1e-6), low, high)
        centre, scale, least, most = (field.astype(np.float32) for field in fields)
        return cls(centre, scale, least, most, linear)

    @property
    def spread(self) -> float:
        """Standard deviation of what is clipped over the balls, mean over channels."""
        return 0.5 * float(self.scale.mean())

    def variables(self, colours: Float32Array) -> tuple[Float32Array, Float32Array]:
        """Return the polynomial variables (..., 3), and the distance (...) of each colour from the range.

        The distance is in standard deviations, 0 within the range.
        """
        seen = colours if self.linear else log_intensity(colours)
        clipped = np.clip(seen, self.low, self.high)
        excess = np.abs(seen - clipped).max(axis=-1) / np.float32(self.spread)
        return (clipped - self.centre) / self.scale, np.asarray(excess, np.float32)

    def intensity_range(self) -> tuple[Float64Array, Float64Array]:
        """Return intensities that a space of intensity clips to, float64 arrays of shape (3,): lowest and highest."""
        low, high = (np.exp(bound.astype(np.float64)) - DARK_OFFSET for bound in (self.low, self.high))
        return low, high

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return everything as arrays but `linear`, which goes with what is read; `from_arrays` is its inverse."""
        return {name: getattr(self, name) for name in ("centre", "scale", "low", "high")}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]], *, linear: bool = False) -> FeatureScaler:
        """Return the space that `arrays` wrote; KeyError or ValueError when malformed."""
        centre, scale, low, high = (
            np.asarray(arrays[name], np.float32).reshape(3) for name in ("centre", "scale", "low", "high")
        )
        return cls(centre, scale, low, high, linear)


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
        """Every term of colours (N, 3) times every monomial of position variables (N, 2): array of shape (N, M K)."""
        variables, _ = self.colours.variables(values)
        by_colour = colour_terms(variables.astype(np.float64), self.colour_degree, self.waves)
        by_place = monomials(place, self.position_degree)
        return np.asarray((by_colour[:, :, None] * by_place[:, None, :]).reshape(len(place), -1))

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
