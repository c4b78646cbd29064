"""Terms of the inverse map: monomials of colour and of place in the field, cosines of colour, and their scaling."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from itertools import product
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from device.surface.fields import Float32Array, Float64Array


def colour_exponents(degree: int) -> list[tuple[int, int, int]]:
    """Return exponents of the monomials of three colours up to a total degree."""
    return [(i, j, k) for i, j, k in product(range(degree + 1), repeat=3) if i + j + k <= degree]


def position_exponents(degree: int) -> list[tuple[int, int]]:
    """Return exponents of the monomials of the two position variables up to a total degree."""
    return [(i, j) for i, j in product(range(degree + 1), repeat=2) if i + j <= degree]


def monomials(variables: NDArray[Any], degree: int) -> NDArray[Any]:
    """Return monomials of shape (N, M) of variables of shape (N, D), D 2 or 3, ordered as the exponents."""
    exponents = colour_exponents(degree) if variables.shape[1] == 3 else position_exponents(degree)
    columns: dict[tuple[int, ...], NDArray[Any]] = {(0,) * variables.shape[1]: np.ones_like(variables[:, 0])}
    for exponent in exponents:
        if exponent in columns:
            continue
        axis = next(i for i, power in enumerate(exponent) if power)
        lower = tuple(power - (i == axis) for i, power in enumerate(exponent))
        columns[exponent] = columns[lower] * variables[:, axis]
    return np.stack([columns[exponent] for exponent in exponents], axis=-1)


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
