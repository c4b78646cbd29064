"""Height map from slopes by full multigrid: min Σ w_e (f_b - f_a - g_e)² over the edges between valid pixels.

Paper, eqs. 9 and 10, with a weight per edge, holes and free (Neumann) borders.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from device.surface.fields import Float32Array, GradientField, HeightMap
from host_sync.errors import IntegrationError
from host_sync.integration.components import center_rectangle, label_components
from host_sync.integration.edges import EdgeRule, edge_coefficients
from host_sync.integration.full_multigrid import full_multigrid
from host_sync.integration.levels import FineLevel, GridLevel, coarser_levels
from host_sync.integration.validation import FieldInfo, raise_slope_error, validate_field
from host_sync.kernels.parallel_rows import BackgroundCall

MIN_TOLERANCE_PX: Final = 1e-4
"""Smallest default tolerance: single precision reaches no further on large fields."""


@dataclass(frozen=True, slots=True)
class IntegrationReport:
    """What the solver did.

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
    """Least-squares height map and a report; as `Integrator.integrate`, for a single field."""
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
        """Least-squares height map and a report.

        A pixel that is invalid or weighs less than `MIN_WEIGHT` of the largest is a hole, NaN in the result. Each
        connected component has a weighted mean of zero.

        edges : how slopes become height differences between neighbours (see `edges`)
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
        found = validate_field(gradients)
        if gradients.valid.shape != self._shape:
            raise IntegrationError(f"this solver is for fields of shape {self._shape}, got {gradients.valid.shape}")
        if out is not None and (out.shape != self._shape or out.dtype != np.float32 or not out.flags.writeable):
            raise IntegrationError(f"`out` must be a writable float32 array of shape {self._shape}")
        field = _fine_level(gradients, found, edges, pitch_um)
        components = None if found.weight is None else BackgroundCall(label_components, found.weight)
        z = np.empty(field.p.shape, np.float32) if out is None else out
        levels = self._coarser(found.weight is not None)
        tolerance_um = None if tolerance_px is None else tolerance_px * pitch_um
        solution = full_multigrid(field, levels, (z, self._spare), components, tolerance_um, max_cycles)
        if np.isnan(solution.error):
            raise_slope_error(gradients)
        if solution.z is not z:
            z[:] = solution.z
        if components is not None and found.weight is not None:
            moments = solution.moments
            parts = components.result()
            parts.center(z, parts.moments(z, found.weight) if moments is None else moments)
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
        """Coarse levels, allocated when first needed."""
        if weighted not in self._levels:
            rows, columns = self._shape
            self._levels[weighted] = coarser_levels((rows, columns), weighted)
        return self._levels[weighted]


def _fine_level(gradients: GradientField, found: FieldInfo, edges: EdgeRule, pitch_um: float) -> FineLevel:
    """The field as the finest level; the pitch goes into the edge coefficients, so heights come out in µm."""
    p, q = (np.ascontiguousarray(slope, np.float32) for slope in (gradients.p, gradients.q))
    rule = np.float32(pitch_um) * edge_coefficients(edges)
    return FineLevel(p, q, found.weight, np.float32(1.0 / found.largest), rule, MIN_TOLERANCE_PX * pitch_um)
