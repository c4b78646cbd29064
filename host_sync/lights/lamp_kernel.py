"""The light that skin sends to the camera under near lamps, point by point: the kernel of `LampModel`."""

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
    fall_off, even, uneven, gloss, narrow, tail, tilt_gain, beam, camera = coat
    slopes = p.shape[1]
    normal = np.empty((slopes, 4))
    for i in range(first, last):
        v0, v1, v2 = -camera * x[i], -camera * y[i], 1.0 - camera * z[i]
        length = np.sqrt(v0 * v0 + v1 * v1 + v2 * v2)
        v0, v1, v2 = v0 / length, v1 / length, v2 / length
        for k in range(slopes):
            up = 1.0 / np.sqrt(1.0 + p[i, k] * p[i, k] + q[i, k] * q[i, k])
            n0, n1 = -p[i, k] * up, -q[i, k] * up
            normal[k, 0], normal[k, 1], normal[k, 2] = n0, n1, up
            normal[k, 3] = max(n0 * v0 + n1 * v1 + up * v2, GRAZING)
            own[i, k, 0] = own[i, k, 1] = own[i, k, 2] = 0.0
        for channel in range(3):
            for point in range(points.shape[1]):
                l0, l1, l2 = points[channel, point, 0] - x[i], points[channel, point, 1] - y[i], 0.0
                l2 = points[channel, point, 2] - z[i]
                square = l0 * l0 + l1 * l1 + l2 * l2
                length = np.sqrt(square)
                l0, l1, l2 = l0 / length, l1 / length, l2 / length
                between = l0 * v0 + l1 * v1 + l2 * v2
                facing = max(axes[channel, 0] * l0 + axes[channel, 1] * l1 + axes[channel, 2] * l2, 0.0)
                bright = points[channel, point, 3] * ((1.0 - beam) + beam * facing) * square ** (-0.5 * fall_off)
                if len(visible):
                    bright *= visible[i, channel, point]
                for k in range(slopes):
                    seen = normal[k, 3]
                    lit = max(normal[k, 0] * l0 + normal[k, 1] * l1 + normal[k, 2] * l2, 0.0)
                    together = max(between - lit * seen, 0.0) / max(max(lit, seen), GRAZING)
                    reflected = lit * (even + uneven * together)
                    if gloss != 0.0:
                        half = min((lit + seen) / np.sqrt(2.0 + 2.0 * between), 1.0)
                        off = (1.0 - half * half) * 2.0 * (1.0 / narrow - 1.0) / tail
                        facets = (1.0 + off) ** -tail / (np.pi * narrow)
                        unmasked = 2.0 * lit / (lit + np.sqrt(narrow + (1.0 - narrow) * lit * lit) + 1e-9)
                        unmasked *= 2.0 * seen / (seen + np.sqrt(narrow + (1.0 - narrow) * seen * seen) + 1e-9)
                        shining = facets * unmasked / max(4.0 * seen, GRAZING)
                        reflected = (1.0 - gloss) * reflected + gloss * shining
                    own[i, k, channel] += bright * reflected
        for k in range(slopes):
            more = 1.0 + tilt_gain * (1.0 - normal[k, 2])
            for channel in range(3):
                own[i, k, channel] *= more
