"""Monomials of colour and of place in the field: the terms that the inverse map is made of."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray


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
    """Return the same with every monomial in a row: shape (M, N), from variables of shape (D, N)."""
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
    """Of every monomial but the constant: the monomial and the variable that it is the product of."""
    exponents: list[tuple[int, ...]] = [*(colour_exponents(degree) if variables == 3 else position_exponents(degree))]
    number = {exponent: at for at, exponent in enumerate(exponents)}
    steps = []
    for exponent in exponents[1:]:
        axis = next(i for i, power in enumerate(exponent) if power)
        steps.append((number[tuple(power - (i == axis) for i, power in enumerate(exponent))], axis))
    return steps


def field_position(column: NDArray[Any], row: NDArray[Any], shape: tuple[int, int]) -> NDArray[Any]:
    """Return the position variables (N, 2), -1 to 1 over a field of `shape` (H, W), from full-size pixel
    coordinates."""
    rows, columns = shape
    return np.stack([(2.0 * column + 1.0) / columns - 1.0, (2.0 * row + 1.0) / rows - 1.0], axis=-1)
