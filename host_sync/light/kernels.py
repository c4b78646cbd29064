"""Light of strip sources on a rough and glossy coat, source by source, and from skin to skin: kernels of `LightModel`.

Light from skin to skin is one bounce over cells by form factors (Nayar, Ikeuchi, Kanade, IJCV 6, 1991).
"""

from __future__ import annotations

from typing import Any, Final

import cv2
import numpy as np

from device.surface import Float32Array, Float64Array
from host_sync.kernels.jit import njit
from host_sync.kernels.parallel_rows import parallel_rows

GRAZING: Final = 0.05
"""Cosine below which reflection is not followed further: the models of rough skin end before."""


@njit(cache=True, nogil=True, error_model="numpy")
def write_light(
    points: Any, axes: Any, coat: Any, p: Any, q: Any, x: Any, y: Any, z: Any, light: Any, first: int, last: int
) -> None:
    """Write the light that each source adds into the rows `first` to `last` - 1 of `light`, (N, S).

    points : of each source, position and brightness, shape (S, points, 4), in widths of the field
    axes : of the sources' beams, shape (S, 3)
    coat : see `LightModel.coat`
    p, q, x, y, z : slopes and places, shape (N,)
    """
    for i in range(first, last):
        v0, v1, v2 = to_camera(coat[8], x[i], y[i], z[i])
        up = 1.0 / np.sqrt(1.0 + p[i] * p[i] + q[i] * q[i])
        n0, n1 = -p[i] * up, -q[i] * up
        seen = max(n0 * v0 + n1 * v1 + up * v2, GRAZING)
        tilted = 1.0 + coat[6] * (1.0 - up)
        for source in range(points.shape[0]):
            total = 0.0
            for point in range(points.shape[1]):
                l0, l1, l2, bright = ray_to(points[source, point], axes[source], coat, x[i], y[i], z[i])
                lit = max(n0 * l0 + n1 * l1 + up * l2, 0.0)
                total += bright * reflected(lit, seen, l0 * v0 + l1 * v1 + l2 * v2, coat)
            light[i, source] = tilted * total


@njit(cache=True, error_model="numpy")
def to_camera(camera: Any, x: Any, y: Any, z: Any) -> Any:
    """Return the direction from a place to the camera."""
    across, down, up = -camera * x, -camera * y, 1.0 - camera * z
    length = np.sqrt(across * across + down * down + up * up)
    return across / length, down / length, up / length


@njit(cache=True, error_model="numpy")
def ray_to(point: Any, axis: Any, coat: Any, x: Any, y: Any, z: Any) -> Any:
    """Return the direction from a place to a point of a source, and the irradiance of a surface that faces it."""
    across, down, up = point[0] - x, point[1] - y, point[2] - z
    square = across * across + down * down + up * up
    length = np.sqrt(square)
    across, down, up = across / length, down / length, up / length
    facing = max(axis[0] * across + axis[1] * down + axis[2] * up, 0.0)
    beam = coat[7]
    return across, down, up, point[3] * ((1.0 - beam) + beam * facing) * square ** (-0.5 * coat[0])


@njit(cache=True, error_model="numpy")
def reflected(lit: Any, seen: Any, between: Any, coat: Any) -> Any:
    """Return the fraction of a ray that a coat reflects.

    lit, seen, between : cosines between normal and light, normal and camera, light and camera
    """
    if lit == 0.0:
        return 0.0
    even, uneven, gloss, narrow, tail = coat[1], coat[2], coat[3], coat[4], coat[5]
    together = max(between - lit * seen, 0.0) / max(max(lit, seen), GRAZING)
    rough = lit * (even + uneven * together)
    matt = rough + coat[9] * (2.0 * lit / (lit + seen) - rough)
    if gloss == 0.0:
        return matt
    half = min((lit + seen) / np.sqrt(2.0 + 2.0 * between), 1.0)
    off = (1.0 - half * half) * 2.0 * (1.0 / narrow - 1.0) / tail
    facets = (1.0 + off) ** -tail / (np.pi * narrow)
    unmasked = 2.0 * lit / (lit + np.sqrt(narrow + (1.0 - narrow) * lit * lit) + 1e-9)
    unmasked *= 2.0 * seen / (seen + np.sqrt(narrow + (1.0 - narrow) * seen * seen) + 1e-9)
    shining = facets * unmasked / max(4.0 * seen, GRAZING)
    return (1.0 - gloss) * matt + gloss * shining


@njit(cache=True, error_model="numpy")
def reflected_changes(lit: Any, seen: Any, between: Any, unmasked: Any, by_unmasked: Any, coat: Any) -> Any:
    """Return the reflected share of a ray above the horizon, and its derivatives by `lit` and `seen`.

    lit, seen, between, coat : see `reflected`
    unmasked, by_unmasked : see `unmasked_changes`
    """
    even, uneven, gloss, narrow, tail = coat[1], coat[2], coat[3], coat[4], coat[5]
    excess, largest = between - lit * seen, max(max(lit, seen), GRAZING)
    together, by_lit, by_seen = 0.0, 0.0, 0.0
    if excess > 0.0:
        together = excess / largest
        by_lit = -(seen + (together if lit >= seen else 0.0)) / largest
        by_seen = -(lit + (0.0 if lit >= seen else together)) / largest
    rough, rough_by_seen = lit * (even + uneven * together), lit * uneven * by_seen
    rough_by_lit = even + uneven * together + lit * uneven * by_lit
    both, scattering = lit + seen, coat[9]
    matt = rough + scattering * (2.0 * lit / both - rough)
    matt_by_lit = rough_by_lit + scattering * (2.0 * seen / (both * both) - rough_by_lit)
    matt_by_seen = rough_by_seen - scattering * (2.0 * lit / (both * both) + rough_by_seen)
    if gloss == 0.0:
        return matt, matt_by_lit, matt_by_seen
    wide = np.sqrt(2.0 + 2.0 * between)
    half, by_half = (lit + seen) / wide, 1.0 / wide
    if half > 1.0:
        half, by_half = 1.0, 0.0
    ratio = 2.0 * (1.0 / narrow - 1.0) / tail
    spread = 1.0 + (1.0 - half * half) * ratio
    facets = spread**-tail / (np.pi * narrow)
    root = np.sqrt(narrow + (1.0 - narrow) * lit * lit)
    whole = lit + root + 1e-9
    arriving = 2.0 * lit / whole
    by_arriving = 2.0 / whole - arriving / whole * (1.0 + (1.0 - narrow) * lit / root)
    shining = facets * arriving * unmasked
    turning = shining * 2.0 * tail * half * ratio / spread * by_half
    return (
        (1.0 - gloss) * matt + gloss * shining,
        (1.0 - gloss) * matt_by_lit + gloss * (turning + facets * by_arriving * unmasked),
        (1.0 - gloss) * matt_by_seen + gloss * (turning + facets * arriving * by_unmasked),
    )


@njit(cache=True, error_model="numpy")
def unmasked_changes(seen: Any, narrow: Any) -> Any:
    """Return the share of a lobe that facets do not hide from the camera, over 4 `seen`, and its derivative."""
    root = np.sqrt(narrow + (1.0 - narrow) * seen * seen)
    whole = seen + root + 1e-9
    return 0.5 / whole, -0.5 / (whole * whole) * (1.0 + (1.0 - narrow) * seen / root)


@njit(cache=True, nogil=True, error_model="numpy")
def write_search(
    sources: Any, skin: Any, seen: Any, prior: Any, limits: Any, steps: int, rows: Any, slope: Any, change: Any,
    weight: Any, first: int, last: int,
) -> None:  # fmt: skip
    """Move rows of `slope`, (N, 2), by Gauss-Newton steps to the largest posterior: of `rows` from `first` to `last`.

    sources : points, axes and coat see `write_light`; strengths (C, S), haze (C,) and the monomials' exponents (M, 2)
    skin : places x, y and z, shape (N,); light at rest (N, C), visible fractions (N, S), incoming light over that at
        rest (N, C) and the residual's coefficients (N, C, M + 1)
    seen : intensity and the variance of its prediction, shape (N, C)
    prior : slopes expected beforehand, shape (N, 2), and one over their variance, shape (N,)
    limits : longest step, standard uncertainty of light that another place hides as a fraction of it, standard
        deviations at which an error counts half, and `ELEVATION`
    change : receives the derivatives of intensity, shape (N, C, 2)
    weight : receives one over the variance that each channel was given in the last step, shape (N, C)
    """
    points, axes, coat, strengths, haze, exponents = sources
    x, y, z, rest, visible, incoming, residual = skin
    intensity, variance = seen
    expected, known = prior
    longest, hidden_sigma, outlying, elevation = limits
    count, channels, terms = points.shape[0], strengths.shape[0], exponents.shape[0]
    rays, normal = np.empty((count, points.shape[1], 5)), np.empty((3, 4))
    light, shown, dark = np.empty((3, count)), np.empty((3, channels)), np.empty(channels)
    powers, values = np.empty((2, 5)), np.empty((terms + 1, 3))
    values[terms, 1] = values[terms, 2] = 0.0
    for number in range(first, last):
        i = rows[number]
        v0, v1, v2 = to_camera(coat[8], x[i], y[i], z[i])
        for source in range(count):
            for point in range(points.shape[1]):
                l0, l1, l2, bright = ray_to(points[source, point], axes[source], coat, x[i], y[i], z[i])
                rays[source, point, 0], rays[source, point, 1], rays[source, point, 2] = l0, l1, l2
                rays[source, point, 3], rays[source, point, 4] = l0 * v0 + l1 * v1 + l2 * v2, bright
        values[terms, 0] = z[i] / elevation
        for _ in range(steps):
            # The normal, its derivatives by p and q, and in the last column its cosine to the camera.
            p, q = slope[i, 0], slope[i, 1]
            up = 1.0 / np.sqrt(1.0 + p * p + q * q)
            cube = up * up * up
            normal[0, 0], normal[0, 1], normal[0, 2] = -p * up, -q * up, up
            normal[1, 0], normal[1, 1], normal[1, 2] = p * p * cube - up, p * q * cube, -p * cube
            normal[2, 0], normal[2, 1], normal[2, 2] = p * q * cube, q * q * cube - up, -q * cube
            for k in range(3):
                normal[k, 3] = normal[k, 0] * v0 + normal[k, 1] * v1 + normal[k, 2] * v2
            if normal[0, 3] < GRAZING:
                normal[0, 3], normal[1, 3], normal[2, 3] = GRAZING, 0.0, 0.0
            unmasked, by_unmasked = unmasked_changes(normal[0, 3], coat[4])
            tilted = 1.0 + coat[6] * (1.0 - up)
            for source in range(count):
                light[0, source] = light[1, source] = light[2, source] = 0.0
                for point in range(points.shape[1]):
                    l0, l1, l2 = rays[source, point, 0], rays[source, point, 1], rays[source, point, 2]
                    lit = normal[0, 0] * l0 + normal[0, 1] * l1 + normal[0, 2] * l2
                    if lit <= 0.0:
                        continue
                    bright = rays[source, point, 4]
                    share, by_lit, by_seen = reflected_changes(
                        lit, normal[0, 3], rays[source, point, 3], unmasked, by_unmasked, coat
                    )
                    light[0, source] += bright * share
                    for k in range(1, 3):
                        lit_by = normal[k, 0] * l0 + normal[k, 1] * l1 + normal[k, 2] * l2
                        light[k, source] += bright * (by_lit * lit_by + by_seen * normal[k, 3])
                for k in range(1, 3):
                    light[k, source] = tilted * light[k, source] - coat[6] * normal[k, 2] * light[0, source]
                light[0, source] *= tilted
            for channel in range(channels):
                dark[channel] = 0.0
                for k in range(3):
                    total = haze[channel] if k == 0 else 0.0
                    for source in range(count):
                        total += strengths[channel, source] * visible[i, source] * light[k, source]
                    shown[k, channel] = total / rest[i, channel]
                shown[0, channel] += incoming[i, channel]
                for source in range(count):
                    dark[channel] += strengths[channel, source] * (1.0 - visible[i, source]) * light[0, source]
                dark[channel] /= rest[i, channel]
            powers[0, 0] = powers[1, 0] = 1.0
            for order in range(1, 5):
                powers[0, order] = powers[0, order - 1] * normal[0, 0]
                powers[1, order] = powers[1, order - 1] * normal[0, 1]
            for term in range(terms):
                across, down = exponents[term, 0], exponents[term, 1]
                values[term, 0] = powers[0, across] * powers[1, down]
                by_across = across * powers[0, max(across - 1, 0)] * powers[1, down]
                by_down = down * powers[0, across] * powers[1, max(down - 1, 0)]
                values[term, 1] = by_across * normal[1, 0] + by_down * normal[1, 1]
                values[term, 2] = by_across * normal[2, 0] + by_down * normal[2, 1]
            for channel in range(channels):
                level, right, below = shown[0, channel], shown[1, channel], shown[2, channel]
                for term in range(terms + 1):
                    share = residual[i, channel, term]
                    level += share * values[term, 0]
                    right += share * values[term, 1]
                    below += share * values[term, 2]
                shown[0, channel], shown[1, channel], shown[2, channel] = level, right, below
            pp, pq, qq = known[i], 0.0, known[i]
            along_p, along_q = known[i] * (expected[i, 0] - slope[i, 0]), known[i] * (expected[i, 1] - slope[i, 1])
            for channel in range(channels):
                by_p, by_q = shown[1, channel], shown[2, channel]
                error = intensity[i, channel] - shown[0, channel]
                spread = variance[i, channel] + (hidden_sigma * dark[channel]) ** 2
                counts = 1.0 / (spread + error * error / (outlying * outlying))
                pp += counts * by_p * by_p
                pq += counts * by_p * by_q
                qq += counts * by_q * by_q
                along_p += counts * error * by_p
                along_q += counts * error * by_q
                change[i, channel, 0], change[i, channel, 1], weight[i, channel] = by_p, by_q, counts
            determinant = pp * qq - pq * pq
            across, down = (qq * along_p - pq * along_q) / determinant, (pp * along_q - pq * along_p) / determinant
            bound = min(1.0, longest / max(np.sqrt(across * across + down * down), 1e-9))
            slope[i, 0] += bound * across
            slope[i, 1] += bound * down


WIDEST_CELLS: Final = 96
SCAN_CELLS: Final = 48
"""Cells along the columns, at most, of presses that a model is fitted to and of scans: the number of pairs grows with
its fourth power."""

SLANTED: Final = 0.02
RAISED_CELLS: Final = 0.25
"""Slope, and elevation in cells, from which a cell exchanges light with others; level skin at rest adds nothing."""


def incoming_light(
    shown: Float64Array, p: Float32Array, q: Float32Array, z_cells: Float32Array, widest: int = WIDEST_CELLS
) -> Float64Array:
    """Return the light that reaches each cell from all other cells: float64 array of shape (h, w, C).

    shown : radiance of cells, shape (h, w, C)
    p, q : slopes of cells, shape (h, w)
    z_cells : elevation over skin at rest, cells, shape (h, w)
    widest : cells along the columns between which light is exchanged, at most
    """
    rows, columns = z_cells.shape
    factor = max(1, -(-columns // widest))
    size = (-(-columns // factor), -(-rows // factor))

    def reduced(values: Any) -> Float64Array:
        small = cv2.resize(np.ascontiguousarray(values, np.float64), size, interpolation=cv2.INTER_AREA)
        return np.ascontiguousarray(small, np.float64)

    light = reduced(shown).reshape(*size[::-1], -1)
    slopes, z = (reduced(p), reduced(q)), reduced(z_cells) / factor
    active = (np.hypot(*slopes) > SLANTED) | (np.abs(z) > RAISED_CELLS)
    found = np.zeros_like(light)
    if active.any():
        work = size[1], size[0] * size[0] * size[1] // 64
        parallel_rows(_write_incoming, work, light, *slopes, z, active, found)
    large = cv2.resize(found, (columns, rows), interpolation=cv2.INTER_LINEAR)
    return np.asarray(large, np.float64).reshape(shown.shape)


@njit(cache=True, nogil=True, error_model="numpy")
def _write_incoming(light: Any, p: Any, q: Any, z: Any, active: Any, out: Any, first: int, last: int) -> None:
    """Write incoming light into the rows `first` to `last` - 1 of `out`, (h, w, C), lengths in cells."""
    rows, columns, channels = light.shape
    for i in range(first, last):
        for j in range(columns):
            up = 1.0 / np.sqrt(1.0 + p[i, j] * p[i, j] + q[i, j] * q[i, j])
            n0, n1 = -p[i, j] * up, -q[i, j] * up
            for a in range(rows):
                for b in range(columns):
                    if not (active[i, j] or active[a, b]):
                        continue
                    across, down, rise = float(b - j), float(a - i), z[a, b] - z[i, j]
                    received = n0 * across + n1 * down + up * rise
                    if received <= 0.0:
                        continue
                    sent = p[a, b] * across + q[a, b] * down - rise
                    if sent <= 0.0:
                        continue
                    square = across * across + down * down + rise * rise + 0.25
                    factor = received * sent / (np.pi * square * square)
                    for channel in range(channels):
                        out[i, j, channel] += light[a, b, channel] * factor
