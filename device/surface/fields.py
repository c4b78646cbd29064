"""Gradient field and height map, and the conventions of every module.

* Arrays are (row, column); the centre of the first pixel is (0, 0); rows grow downwards.
* p = dz/dcolumn and q = dz/drow, dimensionless (µm/µm).
* z is in µm, positive towards the camera, so a bump on the object is positive.
  Rows down and z to the camera make the frame left-handed; writers of formats with y upwards flip it once.
* Invalid is not zero: NaN in float arrays, False in masks.
* Colour order is R, G, B.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

Float32Array: TypeAlias = NDArray[np.float32]
Float64Array: TypeAlias = NDArray[np.float64]
MaskArray: TypeAlias = NDArray[np.bool_]


MIN_FOURTH_ORDER: Final = 4
"""Pixels that a line must exceed for differences of fourth order."""

NOISE_KEPT: Final = 0.44
"""Share of a pixel's slope noise that integration and central differences leave: the rest belongs to no surface.

Of white noise the fourth-order edges, least squares and the central difference of the height map let pass 0.44 of the
standard deviation (the mean over all frequencies of the product of their transfer functions). So much of it counts when
forms and penalties are judged.
"""


@dataclass(frozen=True, slots=True, eq=False)
class GradientField:
    """Slopes of a surface, estimated per pixel.

    p, q : float32 arrays of shape (H, W), µm/µm; finite where `valid` is True
    valid : bool array of shape (H, W)
    weight : float32 array of shape (H, W), relative confidence >= 0, zero where invalid
    """

    p: Float32Array
    q: Float32Array
    valid: MaskArray
    weight: Float32Array


def full_rectangle(p: Float32Array, q: Float32Array) -> GradientField:
    """Return a gradient field without holes or weights: every pixel is valid and has weight 1.

    `valid` and `weight` are read-only broadcast views of one value.
    """
    return GradientField(p, q, np.broadcast_to(np.True_, p.shape), np.broadcast_to(np.float32(1.0), p.shape))


@dataclass(frozen=True, slots=True, eq=False)
class HeightMap:
    """A surface on a grid.

    z_um : float32 array of shape (H, W), µm, NaN where invalid
    pitch_um : distance of neighbouring pixels on the skin, µm
    """

    z_um: Float32Array
    pitch_um: float


def surface_slopes(height: HeightMap) -> tuple[Float32Array, Float32Array]:
    """Return slopes (p, q) by central differences: float32 arrays of shape (H, W), NaN next to invalid pixels.

    They are of fourth order, which keep 0.995 of a wave of 10 px instead of 0.935; of second order, or one-sided, next
    to invalid pixels and the border.
    """
    z = np.ascontiguousarray(height.z_um / np.float32(height.pitch_um), np.float32)
    return _slope(z, 1), _slope(z, 0)


def _slope(z: Float32Array, axis: int) -> Float32Array:
    """Return the slope along an axis of at least two pixels."""
    near = np.asarray(np.gradient(z, axis=axis), np.float32)
    if z.shape[axis] > MIN_FOURTH_ORDER:
        kernel = np.array([[1.0, -8.0, 0.0, 8.0, -1.0]], np.float32) / np.float32(12.0)
        inner = (slice(None),) * axis + (slice(2, -2),)
        far = cv2.filter2D(z, cv2.CV_32F, kernel if axis else kernel.T)[inner]
        np.copyto(near[inner], far, where=np.isfinite(far))
    return near
