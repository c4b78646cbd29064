"""Height map from slopes by full multigrid: min Σ w_e (f_b - f_a - g_e)² over the edges between valid pixels.

Paper, eqs. 9 and 10, with a weight per edge, holes and free (Neumann) borders. `surface_slopes` is the way back.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from device.surface import MIN_FOURTH_ORDER, Float32Array, GradientField, HeightMap, MaskArray
from host_sync.errors import IntegrationError
from host_sync.integration.components import center_rectangle, label_components
from host_sync.integration.full_multigrid import full_multigrid
from host_sync.integration.levels import EdgeRule, FineLevel, GridLevel, coarser_levels, edge_coefficients
from host_sync.kernels.jit import njit
from host_sync.kernels.parallel_rows import BackgroundCall, parallel_rows

# Validates a gradient field before integration and finds out whether it needs the weighted kernels.

MIN_SIDE_PX: Final = 3

MIN_WEIGHT: Final = 1e-12
"""Weights below this fraction of the largest count as zero: their noise is a million times that of the best pixel, and
single precision cannot solve for both."""

INFINITE: Final = np.int32(0x7F800000)
MINUS_ZERO: Final = np.int32(-0x80000000)
"""Bit patterns of float32 infinity and minus zero; those of other non-finite numbers are larger or negative."""


def validated_weight(gradients: GradientField) -> tuple[Float32Array | None, float]:
    """Return the weights of a field, float32 array of shape (H, W), 0 at holes, and the largest of them.

    A full rectangle of equal weights has None and 1. Slopes are checked by `raise_slope_error` when heights are not
    finite.

    Raises
    ------
    IntegrationError
        Shapes differ or are too small, a valid pixel has no finite weight, or no pixel is valid.
    """
    shape = gradients.valid.shape
    if any(part.shape != shape for part in (gradients.p, gradients.q, gradients.weight)):
        shapes = ", ".join(f"{n} {getattr(gradients, n).shape}" for n in ("p", "q", "valid", "weight"))
        raise IntegrationError(f"arrays of the gradient field differ in shape ({shapes}): give arrays of one (H, W)")
    if len(shape) != 2 or min(shape) < MIN_SIDE_PX:
        raise IntegrationError(f"a gradient field of shape {shape} is too small: integration needs at least 3x3 pixels")
    if _is_broadcast_scalar(gradients.weight) and gradients.weight[0, 0] == 1.0 and _all_true(gradients.valid):
        return None, 1.0
    weight = np.ascontiguousarray(gradients.weight, np.float32)
    if _all_equal(gradients.valid, weight):
        return None, 1.0
    counts, extremes = np.zeros((shape[0], 3), np.int32), np.zeros((shape[0], 2), np.int32)
    parallel_rows(_scan_rows, shape, gradients.valid, weight.view(np.int32), counts, extremes)
    used, odd, stray = (int(count) for count in counts.sum(axis=0))
    if odd:
        raise IntegrationError(f"{odd} valid pixels have a negative or non-finite weight: mark them as invalid")
    if used == 0:
        raise IntegrationError(
            "no pixel of the gradient field is valid, so there is nothing to integrate: repeat the scan"
        )
    smallest, largest = (float(w.view(np.float32)) for w in (extremes[:, 0].min(), extremes[:, 1].max()))
    if used == weight.size and smallest == largest:
        return None, 1.0
    if stray:
        weight = np.where(gradients.valid, weight, np.float32(0.0))
    if smallest < MIN_WEIGHT * largest or largest < np.finfo(np.float32).tiny:
        return _normalize(weight, largest), 1.0
    return weight, largest


def _normalize(weight: Float32Array, largest: float) -> Float32Array:
    """Return the weights divided by the largest, 0 where the quotient is below `MIN_WEIGHT`."""
    fractions = weight.astype(np.float64) / largest
    return np.where(fractions >= MIN_WEIGHT, fractions, 0.0).astype(np.float32)


def _is_broadcast_scalar(values: NDArray[Any]) -> bool:
    """Return True where all pixels share one number in memory (see `full_rectangle`)."""
    return not any(values.strides)


def _all_true(mask: MaskArray) -> bool:
    return bool(mask[0, 0] if _is_broadcast_scalar(mask) else mask.all())


def _all_equal(valid: MaskArray, weight: Float32Array) -> bool:
    """Return True where every pixel is valid with the same weight: the common case, found in one fast pass."""
    if not (np.isfinite(weight[0, 0]) and weight[0, 0] > 0.0):
        return False
    others = np.zeros(len(weight), np.int32)
    parallel_rows(_count_others, weight.shape, valid, weight, weight[0, 0], others)
    return not others.any()


@njit(cache=True, nogil=True)
def _count_others(valid: Any, weight: Any, usual: Any, others: Any, first: int, last: int) -> None:
    """Write per row the number of pixels that are invalid or have another weight; stop at the first such row."""
    for r in range(first, last):
        others[r] = _row_others(valid[r], weight[r], usual)
        if others[r] > 0:
            return


@njit(cache=True)
def _row_others(valid: Any, weight: Any, usual: Any) -> Any:
    count = np.int32(0)
    for c in range(valid.size):
        count += np.int32(valid[c]) & np.int32(weight[c] == usual)
    return np.int32(valid.size) - count


def raise_slope_error(gradients: GradientField) -> None:
    """Raise the error that explains why heights are not finite.

    Raises
    ------
    IntegrationError
        A valid pixel has no finite slope, or slopes are too large.
    """
    finite = np.isfinite(gradients.p) & np.isfinite(gradients.q)
    faulty = gradients.valid & (gradients.weight > 0.0) & ~finite
    if faulty.any():
        raise IntegrationError(
            f"{faulty.sum()} valid pixels have a non-finite slope, the first in row {np.nonzero(faulty)[0][0]}: "
            "mark them as invalid"
        )
    used = gradients.valid & (gradients.weight > 0.0)
    steepest = np.where(used, np.maximum(np.abs(gradients.p), np.abs(gradients.q)), 0.0)
    row = int(np.argmax(steepest)) // used.shape[1]
    raise IntegrationError(
        f"slopes as large as {steepest.max():.2g} (row {row}) cannot be integrated in single precision: "
        "check their unit, or mark these pixels as invalid"
    )


@njit(cache=True, nogil=True)
def _scan_rows(valid: Any, bits: Any, counts: Any, extremes: Any, first: int, last: int) -> None:
    """Write the counts and the extreme weights of each row.

    bits : int32 array of shape (H, W), bit patterns of the weights; positive floats sort like their bits
    counts : pixels used, valid ones without a usable weight, invalid ones with a weight
    extremes : least and largest weight
    """
    for r in range(first, last):
        _scan_row(valid[r], bits[r], counts[r], extremes[r])


@njit(cache=True)
def _scan_row(valid: Any, bits: Any, counts: Any, extremes: Any) -> None:
    """Write the counts of one row, in integer arithmetic that compiles to vector code."""
    used, odd, stray = np.int32(0), np.int32(0), np.int32(0)
    least, largest = INFINITE, np.int32(0)
    for c in range(valid.size):
        w, counted = bits[c], np.int32(valid[c])
        positive = np.int32(w > 0)
        usable = counted & positive
        used += usable
        odd += counted & (np.int32(w >= INFINITE) | (np.int32(w < 0) & np.int32(w != MINUS_ZERO)))
        stray += (1 - counted) & np.int32(w != 0)
        least = min(least, w | ((usable - 1) & INFINITE))
        largest = max(largest, w & -usable)
    counts[0], counts[1], counts[2] = used, odd, stray
    extremes[0], extremes[1] = least, largest


MIN_TOLERANCE_PX: Final = 1e-4
"""Smallest default tolerance: single precision reaches no further on large fields."""


@dataclass(frozen=True, slots=True)
class IntegrationReport:
    """Cycles and errors of a solution.

    cycles : V-cycles on the finest level; 0 where full multigrid was accurate enough
    residuals : root mean square residual in each of them, after its first smoothing, pixels times weight
    components : number of connected components; each has its own mean
    converged : whether the estimated algebraic error reached the tolerance
    error_px : estimated algebraic error, root mean square, pixels
    """

    cycles: int
    residuals: tuple[float, ...]
    components: int
    converged: bool
    error_px: float


def integrate(
    gradients: GradientField,
    pitch_um: float,
    *,
    edges: EdgeRule = "fourth-order",
    tolerance_px: float | None = None,
    max_cycles: int = 200,
) -> tuple[HeightMap, IntegrationReport]:
    """Return the least-squares height map and a report; as `Integrator.integrate`, for a single field."""
    solver = Integrator(gradients.valid.shape)
    return solver.integrate(gradients, pitch_um, edges=edges, tolerance_px=tolerance_px, max_cycles=max_cycles)


class Integrator:
    """Solver for gradient fields of one shape; keeps its working arrays from one field to the next.

    Allocating memory takes longer than solving, so use one of these for a video or any series of fields.

    shape : (H, W) of the fields, at least 3x3
    """

    def __init__(self, shape: tuple[int, ...]) -> None:
        self._shape = shape
        self._levels: dict[bool, list[GridLevel]] = {}
        self._spare = np.empty(shape, np.float32)

    def integrate(
        self,
        gradients: GradientField,
        pitch_um: float,
        *,
        edges: EdgeRule = "fourth-order",
        tolerance_px: float | None = None,
        max_cycles: int = 200,
        out: Float32Array | None = None,
    ) -> tuple[HeightMap, IntegrationReport]:
        """Return the least-squares height map and a report.

        A pixel that is invalid or weighs less than `MIN_WEIGHT` of the largest is a hole, NaN in the result. Each
        connected component has a weighted mean of zero.

        edges : how slopes become height differences between neighbours (see `levels`)
        tolerance_px : estimated algebraic error at which cycles end, pixels; None: a small fraction of what noise does
            to the heights. Below what single precision reaches, cycles end there and the report says `converged=False`
        max_cycles : maximum number of V-cycles on the finest level
        out : C-contiguous float32 array of shape (H, W) that receives the heights; None for a new one

        Raises
        ------
        IntegrationError
            The pitch is not positive, shapes differ, a valid pixel has no finite slope or weight, no pixel is valid, or
            `out` has the wrong shape or type.
        """
        if not (np.isfinite(pitch_um) and pitch_um > 0.0):
            raise IntegrationError(f"pixel pitch must be positive and finite, got {pitch_um} µm")
        weight, largest = validated_weight(gradients)
        if gradients.valid.shape != self._shape:
            raise IntegrationError(f"this solver is for fields of shape {self._shape}, got {gradients.valid.shape}")
        if out is not None and (out.shape != self._shape or out.dtype != np.float32 or not out.flags.writeable):
            raise IntegrationError(f"`out` must be a writable float32 array of shape {self._shape}")
        p, q = (np.ascontiguousarray(slope, np.float32) for slope in (gradients.p, gradients.q))
        # The pitch goes into the edge coefficients, so that heights come out in µm.
        rule = np.float32(pitch_um) * edge_coefficients(edges)
        field = FineLevel(p, q, weight, np.float32(1.0 / largest), rule, MIN_TOLERANCE_PX * pitch_um)
        components = None if weight is None else BackgroundCall(label_components, weight)
        z = np.empty(field.p.shape, np.float32) if out is None else out
        levels = self._coarser(weight is not None)
        tolerance_um = None if tolerance_px is None else tolerance_px * pitch_um
        solution = full_multigrid(field, levels, (z, self._spare), components, tolerance_um, max_cycles)
        if np.isnan(solution.error):
            raise_slope_error(gradients)
        if solution.z is not z:
            z[:] = solution.z
        if components is not None and weight is not None:
            moments = solution.moments
            parts = components.result()
            parts.center(z, parts.moments(z, weight) if moments is None else moments)
        elif not solution.centered:
            center_rectangle(z)
        residuals = tuple(residual / pitch_um for residual in solution.residuals)
        return HeightMap(z, pitch_um), IntegrationReport(
            cycles=len(residuals),
            residuals=residuals,
            components=components.result().count if components else 1,
            converged=solution.error <= solution.tolerance,
            error_px=solution.error / pitch_um,
        )

    def _coarser(self, weighted: bool) -> list[GridLevel]:
        """Return the coarse levels, allocated when first needed."""
        if weighted not in self._levels:
            rows, columns = self._shape
            self._levels[weighted] = coarser_levels((rows, columns), weighted)
        return self._levels[weighted]


# Compiles the solver's kernels before they are needed, beside other work of a first run.

EVEN: Final = (96, 128)
ODD: Final = (95, 127)
"""Sizes of fields with levels enough for every kernel of a frame; a side that cannot be halved takes other steps."""


def compile_integration() -> None:
    """Solve small fields with equal weights, and one with weights and a hole; what is compiled stays in the cache."""
    for shape in (EVEN, ODD):
        integrate(_flat(np.ones(shape, np.float32)), 1.0)
    weight = np.full(EVEN, 0.5, np.float32)
    weight[:, :20] = 1.0
    weight[40:50, 60:70] = 0.0
    integrate(_flat(weight), 1.0)


def _flat(weight: Float32Array) -> GradientField:
    """Return slopes of zero with these weights."""
    return GradientField(np.zeros_like(weight), np.zeros_like(weight), weight > 0.0, weight)


# Slopes of a full-size height map in one pass over memory: the workstation's form of `device.surface.surface_slopes`.


def surface_slopes(height: HeightMap) -> tuple[Float32Array, Float32Array]:
    """Return slopes (p, q) by central differences: float32 arrays of shape (H, W), the portable ones but for rounding.

    H and W are at least 2.
    """
    z_um = np.ascontiguousarray(height.z_um, np.float32)
    p, q = np.empty_like(z_um), np.empty_like(z_um)
    parallel_rows(_write_slopes, z_um.shape, z_um, np.float32(1.0 / height.pitch_um), p, q)
    return p, q


@njit(cache=True, nogil=True)
def _write_slopes(z: Any, per_um: Any, p: Any, q: Any, first: int, last: int) -> None:
    rows = len(z)
    for r in range(first, last):
        _across(z[r], per_um, p[r])
        above, below = z[max(r - 1, 0)], z[min(r + 1, rows - 1)]
        if rows > MIN_FOURTH_ORDER and 2 <= r < rows - 2:
            _between(z[r - 2], above, below, z[r + 2], per_um, q[r])
        else:
            _difference(above, below, per_um / np.float32(min(r + 1, rows - 1) - max(r - 1, 0)), q[r])


@njit(cache=True)
def _across(z: Any, per_um: Any, p: Any) -> None:
    last = z.size - 1
    p[0], p[last] = (z[1] - z[0]) * per_um, (z[last] - z[last - 1]) * per_um
    _difference(z[: last - 1], z[2:], np.float32(0.5) * per_um, p[1:last])
    if z.size > MIN_FOURTH_ORDER:
        _between(z[: last - 3], z[1 : last - 2], z[3:last], z[4:], per_um, p[2 : last - 1])


@njit(cache=True)
def _difference(before: Any, after: Any, share: Any, out: Any) -> None:
    for c in range(out.size):
        out[c] = (after[c] - before[c]) * share


@njit(cache=True)
def _between(second: Any, before: Any, after: Any, next_but_one: Any, per_um: Any, out: Any) -> None:
    """Fourth order where all four are numbers, second order where the nearer two are."""
    twelfth, half, eight = per_um / np.float32(12.0), np.float32(0.5) * per_um, np.float32(8.0)
    for c in range(out.size):
        near = after[c] - before[c]
        far = eight * near - (next_but_one[c] - second[c])
        out[c] = far * twelfth if np.isfinite(far) else near * half
