"""Height maps at another pitch, reduced, and at the pixels of another map."""

from __future__ import annotations

from typing import Any, Final

import cv2
import numpy as np

from device.align import Pose
from device.surface import Float32Array, HeightMap
from host_sync.errors import ViewError
from host_sync.kernels.jit import njit

MAX_SIDE_PX: Final = 32_000


def at_pitch(height: HeightMap, pitch_um: float) -> Float32Array:
    """Return the height map resampled to another pitch.

    Raises
    ------
    ViewError
        The pitches differ too much.
    """
    factor = height.pitch_um / pitch_um
    if abs(factor - 1.0) < 1e-3:
        return height.z_um
    size = (max(2, round(height.z_um.shape[1] * factor)), max(2, round(height.z_um.shape[0] * factor)))
    if max(size) > MAX_SIDE_PX:
        raise ViewError("the pixel pitches of the two scans differ too much: compare scans of one kind of device")
    way = cv2.INTER_AREA if factor < 1.0 else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(height.z_um, size, interpolation=way), np.float32)


def moved(small: Float32Array, pose: Pose, shape: tuple[int, ...], step: int) -> Float32Array:
    """Return the second map at the pixels of the first; NaN outside it and next to its holes.

    small : the second map, reduced by `step`
    pose : of the second, px of the first, from where the first's middle lies when both lie corner on corner
    shape : of the first map, reduced by `step`
    """
    full = (shape[0] * step, shape[1] * step)
    row, column = centred(shape, full, step)
    at_row = 0.5 * (full[0] - 1) + pose.down + np.cos(pose.turn) * row + np.sin(pose.turn) * column
    at_column = 0.5 * (full[1] - 1) + pose.right - np.sin(pose.turn) * row + np.cos(pose.turn) * column
    down, right = (((at + 0.5) / step - 0.5).astype(np.float32) for at in (at_row, at_column))
    return between_pixels(small, down, right)


def centred(shape: tuple[int, ...], full: tuple[int, ...], step: int) -> tuple[Float32Array, Float32Array]:
    """Return rows and columns of the cell centres relative to the map's centre, px of the full map: arrays (h, w)."""
    places = [
        ((np.arange(count) + 0.5) * step - 0.5 - 0.5 * (whole - 1)).astype(np.float32)
        for count, whole in zip(shape[:2], full[:2], strict=True)
    ]
    row, column = np.meshgrid(*places, indexing="ij")
    return row, column


def reduced(z_um: Float32Array, step: int) -> Float32Array:
    """Return means over squares of `step` pixels; rows and columns beyond the last whole square are dropped."""
    if step == 1:
        return z_um
    rows, columns = (size // step for size in z_um.shape)
    part = z_um[: rows * step, : columns * step]
    return np.asarray(cv2.resize(part, (columns, rows), interpolation=cv2.INTER_AREA), np.float32)


def between_pixels(z_um: Float32Array, row: Float32Array, column: Float32Array) -> Float32Array:
    """Return heights at places (px) by cubic convolution: float32 array of the places' shape.

    NaN where one of the 4 × 4 neighbours is invalid or outside. OpenCV's remap resolves places to 1/32 pixel only.
    """
    found = np.empty(row.shape, np.float32)
    _convolve(np.ascontiguousarray(z_um), np.ascontiguousarray(row), np.ascontiguousarray(column), found)
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def _weights(t: Any) -> Any:
    """Return weights of the pixels at -1, 0, 1 and 2 for a place at fraction `t` of a pixel."""
    t2, t3 = t * t, t * t * t
    return (
        np.float32(0.5 * (-t3 + 2.0 * t2 - t)),
        np.float32(0.5 * (3.0 * t3 - 5.0 * t2 + 2.0)),
        np.float32(0.5 * (-3.0 * t3 + 4.0 * t2 + t)),
        np.float32(0.5 * (t3 - t2)),
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _convolve(z_um: Any, row: Any, column: Any, found: Any) -> None:
    """Write the heights."""
    rows, columns = z_um.shape
    for r in range(found.shape[0]):
        for c in range(found.shape[1]):
            at_row, at_column = int(np.floor(row[r, c])), int(np.floor(column[r, c]))
            if at_row < 1 or at_column < 1 or at_row + 2 >= rows or at_column + 2 >= columns:
                found[r, c] = np.nan
                continue
            down = _weights(row[r, c] - np.float32(at_row))
            right = _weights(column[r, c] - np.float32(at_column))
            total = np.float32(0.0)
            for i in range(4):
                line = np.float32(0.0)
                for j in range(4):
                    line += right[j] * z_um[at_row - 1 + i, at_column - 1 + j]
                total += down[i] * line
            found[r, c] = total
