"""The light that skin sends to the camera under near lamps, point by point: the kernel of `LampModel` and its parts."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from host_sync.kernels.jit import njit

GRAZING: Final = 0.05
"""Cosine below which reflection is not followed further: the models of rough skin end before."""


@njit(cache=True, nogil=True, error_model="numpy")
def write_light(
    points: Any, visible: Any, axes: Any, coat: Any, p: Any, q: Any, x: Any, y: Any, z: Any, own: Any,
    first: int, last: int,
) -> None:  # fmt: skip
    """Write what skin shows of each channel's own lamp into the rows `first` to `last` - 1 of `own`, (N, K, 3).

    points : of each lamp, where it is and how bright, shape (3, points, 4), in widths of the field
    visible : share of each point's light that arrives, shape (N, 3, points), or (0, 3, points) where all of it does
    axes : of the lamps' beams, shape (3, 3)
    coat : fall-off, even and uneven share of the rough coat, gloss, squared width of its lobe, tail, gain with tilt,
        beam and camera
    p, q : K slopes at each place, shape (N, K)
    x, y, z : places, shape (N,)
    """
    tilt_gain, camera = coat[6], coat[8]
    slopes = p.shape[1]
    normal = np.empty((slopes, 4))
    for i in range(first, last):
        v0, v1, v2 = to_camera(camera, x[i], y[i], z[i])
        for k in range(slopes):
            up = 1.0 / np.sqrt(1.0 + p[i, k] * p[i, k] + q[i, k] * q[i, k])
            n0, n1 = -p[i, k] * up, -q[i, k] * up
            normal[k, 0], normal[k, 1], normal[k, 2] = n0, n1, up
            normal[k, 3] = max(n0 * v0 + n1 * v1 + up * v2, GRAZING)
            own[i, k, 0] = own[i, k, 1] = own[i, k, 2] = 0.0
        for channel in range(3):
            for point in range(points.shape[1]):
                l0, l1, l2, bright = ray_to(points[channel, point], axes[channel], coat, x[i], y[i], z[i])
                between = l0 * v0 + l1 * v1 + l2 * v2
                if len(visible):
                    bright *= visible[i, channel, point]
                for k in range(slopes):
                    lit = max(normal[k, 0] * l0 + normal[k, 1] * l1 + normal[k, 2] * l2, 0.0)
                    own[i, k, channel] += bright * reflected(lit, normal[k, 3], between, coat)
        for k in range(slopes):
            more = 1.0 + tilt_gain * (1.0 - normal[k, 2])
            for channel in range(3):
                own[i, k, channel] *= more


@njit(cache=True, error_model="numpy")
def to_camera(camera: Any, x: Any, y: Any, z: Any) -> Any:
    """Direction from a place to the camera."""
    across, down, up = -camera * x, -camera * y, 1.0 - camera * z
    length = np.sqrt(across * across + down * down + up * up)
    return across / length, down / length, up / length


@njit(cache=True, error_model="numpy")
def ray_to(point: Any, axis: Any, coat: Any, x: Any, y: Any, z: Any) -> Any:
    """Direction from a place to a point of a lamp, and how much of its light arrives where nothing hides it."""
    across, down, up = point[0] - x, point[1] - y, point[2] - z
    square = across * across + down * down + up * up
    length = np.sqrt(square)
    across, down, up = across / length, down / length, up / length
    facing = max(axis[0] * across + axis[1] * down + axis[2] * up, 0.0)
    beam = coat[7]
    return across, down, up, point[3] * ((1.0 - beam) + beam * facing) * square ** (-0.5 * coat[0])


@njit(cache=True, error_model="numpy")
def reflected(lit: Any, seen: Any, between: Any, coat: Any) -> Any:
    """Share of a ray that a coat reflects: of cosines between normal and light, normal and camera, light and camera."""
    even, uneven, gloss, narrow, tail = coat[1], coat[2], coat[3], coat[4], coat[5]
    together = max(between - lit * seen, 0.0) / max(max(lit, seen), GRAZING)
    rough = lit * (even + uneven * together)
    if gloss == 0.0:
        return rough
    half = min((lit + seen) / np.sqrt(2.0 + 2.0 * between), 1.0)
    off = (1.0 - half * half) * 2.0 * (1.0 / narrow - 1.0) / tail
    facets = (1.0 + off) ** -tail / (np.pi * narrow)
    unmasked = 2.0 * lit / (lit + np.sqrt(narrow + (1.0 - narrow) * lit * lit) + 1e-9)
    unmasked *= 2.0 * seen / (seen + np.sqrt(narrow + (1.0 - narrow) * seen * seen) + 1e-9)
    shining = facets * unmasked / max(4.0 * seen, GRAZING)
    return (1.0 - gloss) * rough + gloss * shining
