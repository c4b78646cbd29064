"""Candidates, refinement and gate of every pixel in one pass over the intensity (paper, section 5.1).

A row is processed in tiles that stay in cache: intensity gradients, table lookup, then arithmetic over planes of the
tile. The few pixels of ambiguous bins are visited again, candidate by candidate.

Intensity gradients are Sobel's, central differences averaged over three rows or columns (1, 2, 1): ε selects between
candidates and must not depend on a pixel's own noise.

The tile is allocated inside the function with the loops: its constant shape proves to the compiler that its planes do
not overlap, without which there is no SIMD code (six times slower).
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np

from device.surface import Float32Array, MaskArray
from host_sync.johnson2009.lookup_table import LookupTable
from host_sync.kernels.jit import njit
from host_sync.kernels.parallel_rows import parallel_rows

# One candidate of one pixel: its Hessian error, refined slope and confidence (paper, eqs. 4 to 8).
#
# Refinement inverts the first-order Taylor series of the reflectance, R(p, q) ≈ R(p0, q0) + J (p - p0, q - q0)ᵀ, by J⁺
# = (JᵀJ + λI)⁻¹Jᵀ; Tikhonov's λ keeps the step small where the reflectance hardly changes with slope.
#
# Differentiating I = R(p, q) gives [∂I/∂x ∂I/∂y] = J H with H the symmetric Hessian of the height. ε² is the part of
# the intensity gradients that its symmetrized estimate does not explain. It selects among the slopes of an ambiguous
# colour and weights the refinement.
#
# The gate is ω = exp(-ε²/σ²). Equation 8 is printed without the minus sign, so that ω grows with the error, while the
# sentence above it says that large errors fall back to the coarse estimate.
#
# The confidence is not in the paper: it measures how uncertain a slope is. It affects neither the selection among
# candidates, which uses ε alone, nor the paper's integration, which weights all pixels equally.
#
# Functions are scalar, on floats and tuples, without branches, so the loop that calls them compiles to SIMD code. A
# candidate c holds p, q, R (3) and J by rows (6).

FAST: Final = {"contract", "arcp", "nsz"}


class GateSettings(NamedTuple):
    """Constants for judging candidates, numpy float32; intensities are relative to the reference.

    tikhonov : λ of equation 5
    gate : σ² of equation 8
    noise : ε² caused by pixel noise alone; below it confidence is not reduced
    flat_variance : trace of (JᵀJ + λI)⁻¹ of the flat skin
    trusted, lost : distance from the model's colours at which confidence is a quarter, and beyond which a slope is
        invalid
    """

    tikhonov: np.float32
    gate: np.float32
    noise: np.float32
    flat_variance: np.float32
    trusted: np.float32
    lost: np.float32


@njit(forceinline=True, fastmath=FAST, error_model="numpy")
def judge_candidate(c: Any, colour: Any, across: Any, down: Any, settings: Any) -> tuple[Any, Any, Any, Any]:
    """(p, q, confidence, ε²) of a candidate at a pixel; among several, the one with the smallest ε² is used.

    c : p, q, R (3) and J by rows (6)
    colour, across, down : intensity of the pixel, its ∂I/∂x and ∂I/∂y, three channels each
    """
    inverse = inverse_gram(c, settings.tikhonov)
    error = hessian_error(c, inverse, across, down)
    error = error if error < np.float32(1e6) else np.float32(1e6)  # the neighbour of a NaN
    away = (colour[0] - c[2], colour[1] - c[3], colour[2] - c[4])
    s, t = pseudo_inverse(c, inverse, away)
    far = misfit(c, s, t, away)
    gate = decay(error / settings.gate)
    unexplained = max(error - settings.noise, np.float32(0.0)) / settings.gate
    return c[0] + gate * s, c[1] + gate * t, _confidence(inverse, far, unexplained, settings), error


@njit(forceinline=True, fastmath=FAST, error_model="numpy")
def _confidence(inverse: Any, far: Any, unexplained: Any, settings: Any) -> Any:
    """Return the confidence relative to that in flat skin.

    It falls with the variance through J⁺, the distance of a colour from the model, and unexplained gradients.
    """
    one = np.float32(1.0)
    precision = min(settings.flat_variance / (inverse[0] + inverse[2]), one)
    near = one / (one + far / (settings.trusted * settings.trusted))
    known = one if far < settings.lost * settings.lost else np.float32(0.0)
    return known * precision * near * near / (one + unexplained)


@njit(forceinline=True, fastmath=FAST, error_model="numpy")
def inverse_gram(c: Any, tikhonov: Any) -> tuple[Any, Any, Any]:
    """Return entries (11, 12, 22) of (JᵀJ + λI)⁻¹ (paper, eq. 5)."""
    a = c[5] * c[5] + c[7] * c[7] + c[9] * c[9] + tikhonov
    b = c[5] * c[6] + c[7] * c[8] + c[9] * c[10]
    d = c[6] * c[6] + c[8] * c[8] + c[10] * c[10] + tikhonov
    scale = np.float32(1.0) / (a * d - b * b)
    return d * scale, -b * scale, a * scale


@njit(forceinline=True, fastmath=FAST, error_model="numpy")
def pseudo_inverse(c: Any, inverse: Any, x: Any) -> tuple[Any, Any]:
    """J⁺ x of a vector of three channels (paper, eq. 5)."""
    s = c[5] * x[0] + c[7] * x[1] + c[9] * x[2]
    t = c[6] * x[0] + c[8] * x[1] + c[10] * x[2]
    return inverse[0] * s + inverse[1] * t, inverse[1] * s + inverse[2] * t


@njit(forceinline=True, fastmath=FAST, error_model="numpy")
def misfit(c: Any, s: Any, t: Any, x: Any) -> Any:
    """Return the squared norm of x - J (s, t)ᵀ."""
    u, v = x[0] - c[5] * s - c[6] * t, x[1] - c[7] * s - c[8] * t
    w = x[2] - c[9] * s - c[10] * t
    return u * u + v * v + w * w


@njit(forceinline=True, fastmath=FAST, error_model="numpy")
def hessian_error(c: Any, inverse: Any, across: Any, down: Any) -> Any:
    """ε²: the part of the intensity gradients that the symmetrized Hessian does not explain (paper, eqs. 6 and 7)."""
    h11, h21 = pseudo_inverse(c, inverse, across)
    h12, h22 = pseudo_inverse(c, inverse, down)
    both = np.float32(0.5) * (h12 + h21)
    return misfit(c, h11, both, across) + misfit(c, both, h22, down)


@njit(forceinline=True, fastmath=FAST, error_model="numpy")
def decay(x: Any) -> Any:
    """exp(-x) for x >= 0 within 1e-5: the eighth power of a short series, which compiles to SIMD code."""
    z, one = min(x * np.float32(0.125), np.float32(2.0)), np.float32(1.0)
    tail = np.float32(1.0 / 6.0) + z * (np.float32(1.0 / 24.0) + z * np.float32(1.0 / 120.0))
    growth = one + z * (one + z * (np.float32(0.5) + z * tail))
    square = growth * growth
    fourth = square * square
    return one / (fourth * fourth)


SOBEL_VARIANCE: Final = 0.1875
"""Variance of an intensity gradient relative to that of a pixel: 1/2 for a central difference times 3/8 for the (1, 2,
1) mean."""

_TILE: Final = 256
_COLOUR: Final = 11
_ACROSS: Final = 14
_DOWN: Final = 17
_RESULT: Final = 20
_PLANES: Final = 23
"""Planes of a tile: candidate (11), intensity (3), ∂I/∂x (3), ∂I/∂y (3), and the results p, q, confidence."""

_FAST = {"contract", "arcp", "nsz"}


def estimate_slopes(
    values: Float32Array,
    lit: MaskArray,
    table: LookupTable,
    settings: GateSettings,
) -> tuple[Float32Array, Float32Array, Float32Array]:
    """Return slopes p, q and confidence of every pixel, float32 arrays (H, W); confidence 0 where p, q are invalid.

    values : float32 array of shape (H, W, 3), intensity
    lit : bool array of shape (H, W), where intensity is valid
    """
    p, q, confidence = (np.zeros(lit.shape, np.float32) for _ in range(3))
    parallel_rows(_estimate_rows, lit.shape, values, lit, table, settings, p, q, confidence)
    return p, q, confidence


@njit(cache=True, nogil=True)
def _estimate_rows(
    values: Any, lit: Any, table: Any, settings: Any, p: Any, q: Any, confidence: Any, begin: int, end: int
) -> None:  # fmt: skip
    """Write slopes and confidence of the rows `begin` to `end` - 1."""
    for row in range(begin, end):
        for start in range(0, values.shape[1], _TILE):
            _estimate_tile(values, lit, table, settings, np.int64(row), start, p, q, confidence)


@njit(cache=True, fastmath=_FAST, error_model="numpy")
def _estimate_tile(
    values: Any, lit: Any, table: Any, settings: Any, row: Any, start: int, p: Any, q: Any, confidence: Any
) -> None:  # fmt: skip
    """Write slopes and confidence of up to `_TILE` pixels of a row from column `start`."""
    first, candidates = table.first, table.candidates
    tile = np.empty((_PLANES, _TILE), np.float32)
    filled, entry = np.empty(_TILE, np.int32), np.empty(_TILE, np.int32)
    count = min(_TILE, values.shape[1] - start)
    _write_intensity(values, row, start, count, tile)
    _write_gradients(values, row, start, count, tile)
    _look_up(tile, count, table.low, table.step, table.bin_of, filled)
    for c in range(count):
        entry[c] = first[filled[c]]
    for field in range(_COLOUR):
        for c in range(count):
            tile[field, c] = candidates[entry[c], field]
    for c in range(_TILE):
        best = judge_candidate(
            (tile[0, c], tile[1, c], tile[2, c], tile[3, c], tile[4, c], tile[5, c],
             tile[6, c], tile[7, c], tile[8, c], tile[9, c], tile[10, c]),
            (tile[11, c], tile[12, c], tile[13, c]),
            (tile[14, c], tile[15, c], tile[16, c]),
            (tile[17, c], tile[18, c], tile[19, c]),
            settings,
        )  # fmt: skip
        tile[20, c], tile[21, c], tile[22, c] = best[0], best[1], best[2]
    for c in range(count):
        if first[filled[c] + 1] - first[filled[c]] > 1:
            _choose(tile, c, first[filled[c]], first[filled[c] + 1], candidates, settings)
    for c in range(count):
        if lit[row, start + c] and np.isfinite(tile[11, c] + tile[12, c] + tile[13, c]):
            p[row, start + c], q[row, start + c] = tile[_RESULT, c], tile[_RESULT + 1, c]
            confidence[row, start + c] = tile[_RESULT + 2, c]


@njit(cache=True)
def _write_intensity(values: Any, row: int, start: int, count: int, tile: Any) -> None:
    for channel in range(3):
        for c in range(count):
            tile[_COLOUR + channel, c] = values[row, start + c, channel]


@njit(cache=True, fastmath=_FAST)
def _write_gradients(values: Any, row: int, start: int, count: int, tile: Any) -> None:
    """Write ∂I/∂x and ∂I/∂y, with borders repeated."""
    rows, columns, _ = values.shape
    above, here, below = values[max(row - 1, 0)], values[row], values[min(row + 1, rows - 1)]
    mean, rise = np.empty(_TILE + 2, np.float32), np.empty(_TILE + 2, np.float32)
    two, eighth = np.float32(2.0), np.float32(0.125)
    before, after = max(start - 1, 0), min(start + count, columns - 1)
    for k in range(3):
        for c in range(count):
            at = start + c
            mean[c + 1] = above[at, k] + two * here[at, k] + below[at, k]
            rise[c + 1] = below[at, k] - above[at, k]
        mean[0] = above[before, k] + two * here[before, k] + below[before, k]
        rise[0] = below[before, k] - above[before, k]
        mean[count + 1] = above[after, k] + two * here[after, k] + below[after, k]
        rise[count + 1] = below[after, k] - above[after, k]
        for c in range(count):
            tile[_ACROSS + k, c] = (mean[c + 2] - mean[c]) * eighth
            tile[_DOWN + k, c] = (rise[c] + two * rise[c + 1] + rise[c + 2]) * eighth


@njit(cache=True, error_model="numpy")
def _look_up(tile: Any, count: int, low: Any, step: Any, bin_of: Any, filled: Any) -> None:
    """Write the filled bin of each intensity; NaN gives the first bin."""
    bins = bin_of.shape[0]
    top, zero = np.float32(bins - 1), np.float32(0.0)
    for channel in range(3):
        scale = np.float32(1.0) / step[channel]
        for c in range(count):
            index = (tile[_COLOUR + channel, c] - low[channel]) * scale
            index = index if index > zero else zero
            index = index if index < top else top
            filled[c] = (filled[c] * bins if channel else 0) + np.int32(index)
    flat = bin_of.reshape(-1)
    for c in range(count):
        filled[c] = flat[filled[c]]


@njit(cache=True, error_model="numpy")
def _choose(tile: Any, c: int, first: int, end: int, candidates: Any, settings: Any) -> None:
    """Write the results of the candidate with the smallest ε² (paper, below eq. 8)."""
    least = np.float32(np.inf)
    for index in range(first, end):
        a = candidates[index]
        judged = judge_candidate(
            (a[0], a[1], a[2], a[3], a[4], a[5], a[6], a[7], a[8], a[9], a[10]),
            (tile[11, c], tile[12, c], tile[13, c]),
            (tile[14, c], tile[15, c], tile[16, c]),
            (tile[17, c], tile[18, c], tile[19, c]),
            settings,
        )
        if judged[3] < least:
            least = judged[3]
            tile[_RESULT, c], tile[_RESULT + 1, c], tile[_RESULT + 2, c] = judged[0], judged[1], judged[2]
