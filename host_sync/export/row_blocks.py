"""A field as the bytes of a file, some rows at a time: twelve megapixels never stand in memory twice."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import DTypeLike

from device.surface import Float32Array

ROWS: Final = 64


def row_blocks(
    field_um: Float32Array, factor: float, kind: DTypeLike, invalid: float = np.nan, padding: int = 0
) -> Iterator[bytes]:
    """The bytes of `field_um` times `factor`, from the top row down, each row from left to right.

    field_um : float32 array of shape (H, W), NaN where invalid
    kind : number format of the file, rounded to if it is one of integers
    invalid : what stands where the field is invalid
    padding : bytes of zero after every row
    """
    kind = np.dtype(kind)
    for first in range(0, field_um.shape[0], ROWS):
        values = field_um[first : first + ROWS] * np.float64(factor)
        if kind.kind in "iu":
            np.rint(values, out=values)
        np.nan_to_num(values, copy=False, nan=invalid)
        block = values.astype(kind)
        if padding:
            wide = np.zeros((block.shape[0], block.shape[1] * kind.itemsize + padding), np.uint8)
            wide[:, : wide.shape[1] - padding] = block.view(np.uint8)
            yield wide.tobytes()
        else:
            yield block.tobytes()


def integer_quantum(field_um: Float32Array) -> float:
    """A step in µm, exact as a float32, of which the highest valid value is about 2³⁰: rounding costs 5e-10 of it."""
    highest = max(float(np.nanmax(field_um)), -float(np.nanmin(field_um)))
    return float(np.float32(highest / 2**30)) if highest > 1e-20 else 1e-9
