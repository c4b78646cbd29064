"""One pixel of each pair of neighbours in a row, in loops over pairs.

Why its neighbour is read too: of numbers that stand two apart, the compiler gathers each by itself, which takes several
times as long as to load whole pairs and sort them. It drops no product with nought, for the other factor may be
infinite; here it is not, so that nothing is added.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numba import njit

NOUGHT: Final = np.float32(0.0)


@njit(inline="always")
def first_of(row: Any, pair: int) -> Any:
    """The first pixel of a pair; both must be finite."""
    return row[2 * pair] + NOUGHT * row[2 * pair + 1]


@njit(inline="always")
def second_of(row: Any, pair: int) -> Any:
    """The second pixel of a pair; both must be finite."""
    return row[2 * pair + 1] + NOUGHT * row[2 * pair]
