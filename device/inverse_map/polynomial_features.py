"""Monomials of colour and of place in the field: the terms that the inverse map is made of."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray


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
