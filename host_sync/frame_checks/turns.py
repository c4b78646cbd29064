"""The ways in which a whole frame can be turned or mirrored."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Turn:
    """One way: rows and columns exchanged or not, then each of them run through backwards or not."""

    name: str
    transposed: bool
    rows_backwards: bool
    columns_backwards: bool

    def of(self, field: NDArray[Any]) -> NDArray[Any]:
        """A field of shape (H, W, ...) turned this way; every one but the quarter turns is its own inverse."""
        turned = field.swapaxes(0, 1) if self.transposed else field
        return turned[:: -1 if self.rows_backwards else 1, :: -1 if self.columns_backwards else 1]


HALF_TURNS: Final = (
    Turn("turned by 180 degrees", False, True, True),
    Turn("mirrored left to right", False, False, True),
    Turn("mirrored top to bottom", False, True, False),
)
"""Every turn that keeps rows rows."""

_QUARTERS = (
    Turn("turned by 90 degrees clockwise", True, True, False),
    Turn("turned by 90 degrees anticlockwise", True, False, True),
    Turn("mirrored about its diagonal", True, False, False),
    Turn("mirrored about its other diagonal", True, True, True),
)
"""Each named after what was done to the frame; it undoes that."""


def turns_of(shape: tuple[int, ...]) -> tuple[Turn, ...]:
    """Every way that leaves a field of shape (H, W, ...) its shape, the untouched one excepted."""
    return HALF_TURNS + (_QUARTERS if shape[0] == shape[1] else ())


def median_deviation(field: NDArray[np.float32]) -> float:
    """Mean over channels of the median absolute deviation from one median, field of shape (H, W, 3)."""
    return float(np.median(np.abs(field - np.median(field)), axis=(0, 1)).mean())
