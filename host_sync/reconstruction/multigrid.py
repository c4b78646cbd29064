"""Height map from slopes by full multigrid: min Σ w_e (f_b - f_a - g_e)² over the edges between valid pixels.

Paper, eqs. 9 and 10, with a weight per edge, holes and free (Neumann) borders.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from device.surface import Float32Array, GradientField, HeightMap
from host_sync.errors import IntegrationError
from host_sync.reconstruction.edge_slopes import EdgeRule, edge_coefficients
from host_sync.reconstruction.full_multigrid import full_multigrid
from host_sync.reconstruction.grid_level import GridLevel, PixelField, coarser_levels
from host_sync.reconstruction.islands import find_islands
from host_sync.reconstruction.rectangle import level_rectangle
from host_sync.reconstruction.row_bands import Beside
from host_sync.reconstruction.survey import FieldSurvey, refuse_slopes, survey

LEAST_TOLERANCE_PX: Final = 1e-4
"""Least tolerance where none is given: single precision reaches no further on large fields."""


@dataclass(frozen=True, slots=True)
class IntegrationReport:
    """What the solver did.

    cycles : V-cycles on the finest level; nought where full multigrid was good enough
    residuals : root mean square of the residual in each of them, after its first smoothing, pixels times weight
    islands : connected parts, each with a level of its own
    converged : whether the estimated algebraic error reached the tolerance
    error_px : estimated algebraic error, root mean square, pixels
    """

    cycles: int
    residuals: tuple[float, ...]
    islands: int
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
    """Height map of least squares, and how it was reached; as `Integrator.integrate`, once."""
    solver = Integrator(gradients.valid.shape)
    return solver.integrate(gradients, pitch_um, edges=edges, tolerance_px=tolerance_px, max_cycles=max_cycles)


class Integrator:
    """A solver for gradient fields of one shape that keeps its working arrays from one field to the next.

    Fresh memory costs more than solving does: for a video, and wherever fields follow each other, use one of these.

    shape : (H, W) of the fields, 3x3 or more
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
        """Height map of least squares, and how it was reached.

        A pixel that is not valid or weighs nothing (less than `LEAST_WEIGHT` of the largest) is a hole, NaN in the
        result. Each island (part that is connected through neighbouring pixels) has a weighted mean of zero.

        edges : how slopes become height differences between neighbours (see `edge_slopes`)
        tolerance_px : estimated algebraic error at which cycles end, pixels; None ends them where it is small beside
            what noise does to the heights. Where it is less than single precision reaches, they end there, and the
            report says that it was not reached
        max_cycles : V-cycles on the finest level after which it ends in any case
        out : C-contiguous float32 array of shape (H, W) that receives the heights; None for a new one

        Raises
        ------
        IntegrationError
            The pitch is no positive number, shapes differ, a valid pixel has no finite slope or weight, no pixel is
            valid, or `out` cannot receive the heights.
        """
        if not (np.isfinite(pitch_um) and pitch_um > 0.0):
            raise IntegrationError(f"a pixel pitch of {pitch_um} µm is none: give the distance of neighbouring pixels")
        found = survey(gradients)
        if gradients.valid.shape != self._shape:
            raise IntegrationError(f"this solver is for fields of shape {self._shape}, not {gradients.valid.shape}")
        if out is not None and (out.shape != self._shape or out.dtype != np.float32 or not out.flags.writeable):
            raise IntegrationError(f"heights need a writable float32 array of shape {self._shape}: give such an `out`")
        field = _pixel_field(gradients, found, edges, pitch_um)
        islands = None if found.weight is None else Beside(find_islands, found.weight)
        z = np.empty(field.p.shape, np.float32) if out is None else out
        levels = self._coarser(found.weight is not None)
        tolerance_um = None if tolerance_px is None else tolerance_px * pitch_um
        solution = full_multigrid(field, levels, (z, self._spare), islands, tolerance_um, max_cycles)
        if np.isnan(solution.error):
            refuse_slopes(gradients)
        if solution.z is not z:
            z[:] = solution.z
        if islands is not None and found.weight is not None:
            moments = solution.moments
            parts = islands.result()
            parts.level(z, parts.moments(z, found.weight) if moments is None else moments)
        elif not solution.levelled:
            level_rectangle(z)
        residuals = tuple(residual / pitch_um for residual in solution.residuals)
        return HeightMap(z, pitch_um), IntegrationReport(
            cycles=len(residuals),
            residuals=residuals,
            islands=islands.result().count if islands else 1,
            converged=solution.error <= solution.tolerance,
            error_px=solution.error / pitch_um,
        )

    def _coarser(self, weighted: bool) -> list[GridLevel]:
        """The levels below the pixels, made when they are first needed."""
        if weighted not in self._levels:
            rows, columns = self._shape
            self._levels[weighted] = coarser_levels((rows, columns), weighted)
        return self._levels[weighted]


def _pixel_field(gradients: GradientField, found: FieldSurvey, edges: EdgeRule, pitch_um: float) -> PixelField:
    """The field as the passes over the finest level read it; heights come in µm at once, by the edges' coefficients."""
    p, q = (np.ascontiguousarray(slope, np.float32) for slope in (gradients.p, gradients.q))
    rule = np.float32(pitch_um) * edge_coefficients(edges)
    return PixelField(p, q, found.weight, np.float32(1.0 / found.largest), rule, LEAST_TOLERANCE_PX * pitch_um)
