"""Where a frame lies under its lights, told by untouched skin: for skin that shows no pattern.

A field that is displaced by s shows untouched skin, divided by the reference, as log I = γ - s·∇ log R: the lights' own
gradient over the field measures s. What is pressed disturbs it, far beyond its contact; by how much is estimated from
how well the untouched cells obey that law, against how well the calibration's presses do.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from device.surface.fields import Float32Array, Float64Array
from host_sync.frame_checks.light_levels import AGREEING
from host_sync.results.record import FrameCheck, not_checked

NAME: Final = "light position"
ROUNDS: Final = 4
OUTLIER: Final = 3.0
MIN_SCATTER: Final = 0.001
"""Cells beyond so many standard deviations are left out; scatter below this is the camera's own."""

SAFETY: Final = 3.0
"""How many times the presses' largest displacement, grown by the frame's scatter, is given away."""

MAX_LIMIT: Final = 0.01
"""Fraction of the field's width; where the limit grows larger the check says nothing."""


@dataclass(frozen=True, slots=True)
class LightShift:
    """Displacement (pixels) and what it rests on: scatter of log intensity, and fraction of the cells."""

    columns_px: float
    rows_px: float
    scatter: float
    fraction: float

    @property
    def distance_px(self) -> float:
        """How far."""
        return float(np.hypot(self.columns_px, self.rows_px))


@dataclass(frozen=True, slots=True, eq=False)
class LightPositionModel:
    """The lights' gradient, and how far the calibration's presses seem displaced.

    gradient : float64 array of shape (h · w, 3, 2), of log light of the reference, per pixel
    presses : of the calibration
    columns : width of the field, pixels
    """

    gradient: Float64Array
    presses: tuple[LightShift, ...]
    columns: int

    @classmethod
    def of(cls, rest: Float32Array, presses: list[Float32Array], columns: int) -> LightPositionModel:
        """The model from log light of the reference in cells (h, w, 3) and the presses' log intensity."""
        cell_px = columns / rest.shape[1]
        gradient = np.stack([np.gradient(rest, axis=axis) for axis in (1, 0)], axis=-1) / cell_px
        flat = gradient.reshape(-1, 3, 2).astype(np.float64)
        found = (_shift(cells, flat) for cells in presses)
        return cls(flat, tuple(shift for shift in found if shift is not None), columns)

    def check(self, cells: Float32Array, tolerance_px: float) -> FrameCheck:
        """The check of a frame's log intensity in cells; `tolerance_px` may always be off."""
        shift = _shift(cells, self.gradient)
        if shift is None or not self.presses:
            return not_checked(NAME, "too little untouched skin shows how the light lies")
        limit = tolerance_px + SAFETY * max(press.distance_px * self._worse(shift, press) for press in self.presses)
        if limit > MAX_LIMIT * self.columns:
            return not_checked(NAME, f"displacements below {limit:.0f} px cannot be told from what is pressed")
        if shift.distance_px <= limit:
            return FrameCheck(NAME, "passed", shift.distance_px, limit, "px")
        words = (
            f"its light lies about {shift.columns_px:+.0f} columns and {shift.rows_px:+.0f} rows beside the "
            f"reference's, {shift.distance_px:.0f} px (at most {limit:.0f} px): camera or lights moved"
        )
        return FrameCheck(NAME, "refused", shift.distance_px, limit, "px", words)

    def _worse(self, shift: LightShift, press: LightShift) -> float:
        """How many times less certain a displacement is than a press's; at least once."""
        scatter = shift.scatter / press.scatter
        return max(scatter * float(np.sqrt(press.fraction / shift.fraction)), 1.0)


def _shift(cells: Float32Array, gradient: Float64Array) -> LightShift | None:
    """The displacement that untouched cells show; None where too few agree."""
    light = cells.reshape(-1, 3).astype(np.float64)
    design = np.zeros((len(light), 3, 5))
    design[:, range(3), range(3)] = 1.0
    design[:, :, 3:] = -gradient
    kept = (np.abs(light - np.median(light, axis=0)) < AGREEING).all(axis=1)
    scatter = MIN_SCATTER
    solution: Float64Array = np.zeros(5)
    for _ in range(ROUNDS):
        if kept.mean() < 0.05:
            return None
        solution = np.asarray(np.linalg.lstsq(design[kept].reshape(-1, 5), light[kept].ravel(), rcond=None)[0])
        left = np.abs(light - design @ solution)
        scatter = max(1.4826 * float(np.median(left[kept])), MIN_SCATTER)
        kept = (left < OUTLIER * scatter).all(axis=1)
    return LightShift(float(solution[3]), float(solution[4]), scatter, float(max(kept.mean(), 1e-3)))
