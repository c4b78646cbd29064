"""A field as bytes in blocks of rows, so that it is never in memory twice."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import DTypeLike

from device.surface.fields import Float32Array

ROWS: Final = 64


def row_blocks(
    field_um: Float32Array, factor: float, kind: DTypeLike, invalid: float = np.nan, padding: int = 0
) -> Iterator[bytes]:
    """The bytes of `field_um` times `factor`, row by row from the top.

    field_um : float32 array of shape (H, W), NaN where invalid
    kind : number format of the file; integers are rounded
    invalid : value of invalid pixels
    padding : zero bytes after each row
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
    """Step (µm, exact in float32) at which the highest valid value has about 2³⁰ steps."""
    highest = max(float(np.nanmax(field_um)), -float(np.nanmin(field_um)))
    return float(np.float32(highest / 2**30)) if highest > 1e-20 else 1e-9
