"""Refuses a frame whose lights shine otherwise than in the calibration: all of them, or one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from device.imaging.frame_light import FrameLight
from device.surface import Float32Array, Float64Array
from host_sync.frame_checks.light_levels import AGREEING, LevelSight, SlopeResponse, pressed_levels, untouched_levels
from host_sync.results.record import FrameCheck, not_checked

NAME: Final = "light levels"
MARGIN: Final = 0.05
"""Log change of a channel, beyond those among the calibration's presses, up to which heights stay useful."""

SIGMAS: Final = 2.5
"""A change counts when it lies so many standard deviations outside of what is allowed."""

MAX_REACH: Final = 0.15
"""Where allowed range and uncertainty of all lights together reach farther, the check says nothing."""

SECOND_LARGEST: Final = 0.25
"""Where the largest patch of equal levels is outside, another one inside clears the frame from this fraction of it on:
a flat object may cover more of the field than untouched skin does."""

MAX_CHANGE: Final = 0.15
MAX_STRAY: Final = 0.05
"""Change of a light, relative, and light of the surroundings, fraction of full scale, that is corrected."""

MAX_PRESS_CHANGE: Final = 0.5
"""Largest relative change of a light in a press of the calibration: a camera may set its white balance by itself."""


def is_light(light: FrameLight) -> bool:
    """Return whether the gains and offsets of a calibration's press may be those of its lights."""
    return light.change <= MAX_PRESS_CHANGE and light.stray <= MAX_STRAY


def change_below(reach: float) -> str:
    """Return the words for light changes up to a log change, which mean nothing where lights may be twice as bright."""
    limit = np.expm1(reach)
    return f"a change of the lights below {limit:.0%}" if limit < 1.0 else "any change of the lights"


@dataclass(frozen=True, slots=True, eq=False)
class LevelModel:
    """Levels of the calibration's own presses.

    low, high : float64 arrays of shape (3,), log levels that are allowed
    common : lowest and highest allowed mean of the three
    response : to slope, None where the presses do not show it
    """

    low: Float64Array
    high: Float64Array
    common: tuple[float, float]
    response: SlopeResponse | None

    @classmethod
    def of(cls, presses: Sequence[Float32Array], response: SlopeResponse | None) -> LevelModel:
        """Return the model from log intensity of each press in cells."""
        seen = [sights[0].levels for cells in presses if (sights := _sights(cells, response))]
        levels = np.array([np.zeros(3), *seen])
        spread = levels[1:].std(axis=0) if len(seen) > 1 else np.zeros(3)
        mean = levels.mean(axis=1)
        off = MARGIN + (float(mean[1:].std()) if len(seen) > 1 else 0.0)
        return cls(
            levels.min(axis=0) - MARGIN - spread,
            levels.max(axis=0) + MARGIN + spread,
            (float(mean.min()) - off, float(mean.max()) + off),
            response,
        )

    @property
    def reach(self) -> float:
        """Largest log change of all lights together that presses of the calibration show or may have."""
        return max(-self.common[0], self.common[1])

    def check_light(self, light: FrameLight) -> tuple[FrameCheck, FrameCheck]:
        """Return the checks of the light of a frame whose untouched skin shows it.

        A channel's light may differ by `MAX_CHANGE`, or as far as the presses show of that channel where that is more.
        """
        change = light.gains - 1.0
        allowed = np.where(change > 0.0, np.expm1(self.high), -np.expm1(self.low))
        most = np.maximum(allowed, MAX_CHANGE)
        worst = int((np.abs(change) / most).argmax())
        drift = abs(float(change[worst])), float(most[worst])
        return (
            _limited("light drift", *drift, "relative", "its lights differ from the calibration's by"),
            _limited(
                "stray light", light.stray, MAX_STRAY, "of full scale", "light of the surroundings is, of full scale,"
            ),
        )

    def check(self, cells: Float32Array) -> FrameCheck:
        """Return the check of a frame's log intensity in cells."""
        sights = _sights(cells, self.response)
        if not sights:
            return not_checked(
                NAME, "no untouched skin is seen, and the calibration does not distinguish slopes from levels"
            )
        largest = sights[0]
        reach = self._reach(largest)
        if reach > MAX_REACH:
            return not_checked(
                NAME,
                f"{change_below(reach)} cannot be distinguished from how the "
                f"calibration's presses differ{'' if largest.untouched else ' and what is pressed'}",
            )
        cleared = any(
            self._is_allowed(other) and other.untouched > SECOND_LARGEST * largest.untouched for other in sights[1:]
        )
        if self._is_allowed(largest) or cleared or (largest.untouched and self._is_tilt(cells, largest)):
            worst = float(np.abs(largest.levels).max())
            return FrameCheck(NAME, "passed", float(np.expm1(worst)), float(np.expm1(reach)), "relative")
        return self._refusal(largest)

    def _is_allowed(self, sight: LevelSight) -> bool:
        """Return True if levels lie within `SIGMAS` standard deviations of the allowed ones."""
        if self._excess_of_common(sight) > SIGMAS:
            return False
        root = np.linalg.cholesky(np.linalg.inv(sight.covariance)).T
        near = np.clip(sight.levels, self.low, self.high)
        if np.linalg.norm(root @ (sight.levels - near)) <= SIGMAS:
            return True  # the nearest allowed levels are no farther
        from scipy.optimize import lsq_linear  # here, because it takes 0.15 s to load

        fit = lsq_linear(root, root @ sight.levels, (self.low, self.high))
        return bool(np.sqrt(2.0 * fit.cost) <= SIGMAS)

    def _excess_of_common(self, sight: LevelSight) -> float:
        """Return the distance of the mean of the three levels from the allowed ones, standard deviations."""
        mean = float(sight.levels.mean())
        beyond = max(self.common[0] - mean, mean - self.common[1], 0.0)
        return beyond / float(np.sqrt(sight.covariance.mean()))

    def _is_tilt(self, cells: Float32Array, sight: LevelSight) -> bool:
        """Return True if levels not allowed may come from a flat object tilted under the whole field."""
        if self.response is None:
            return False
        answer = self.response.terms[0]
        tilted = LevelSight(sight.levels, sight.covariance + self.response.tilt**2 * answer.T @ answer, sight.untouched)
        if not self._is_allowed(tilted):
            return False
        return self._is_allowed(pressed_levels(cells, self.response))

    def _reach(self, sight: LevelSight) -> float:
        """Return the largest log change of all lights together that could pass."""
        sigma = float(np.sqrt(sight.covariance.mean()))
        return self.reach + SIGMAS * sigma

    def _refusal(self, sight: LevelSight) -> FrameCheck:
        """Return what is wrong in words: all lights, or the one that differs most."""
        levels = sight.levels
        where = "its untouched skin" if sight.untouched else "its light"
        mean = float(levels.mean())
        if np.abs(levels - mean).max() < 0.35 * abs(mean):
            limit = self.common[0] if mean < 0.0 else self.common[1]
            value, what = mean, "in all channels"
        else:
            beyond = np.maximum(self.low - levels, levels - self.high)
            worst = int(beyond.argmax())
            value, what = float(levels[worst]), f"in {('red', 'green', 'blue')[worst]}"
            limit = float(self.low[worst] if value < 0.0 else self.high[worst])
        change, most = float(np.expm1(value)), float(np.expm1(limit))
        side = "brighter" if value > 0.0 else "darker"
        words = f"{where} is {abs(change):.0%} {side} {what} than the calibration's (at most {abs(most):.0%})"
        return FrameCheck(NAME, "refused", abs(change), abs(most), "relative", words)


def _sights(cells: Float32Array, response: SlopeResponse | None) -> list[LevelSight]:
    """Return what is seen of the levels: of untouched skin, else by the fit; empty where neither is possible."""
    found = untouched_levels(cells)
    if not found and response is not None:
        found = [pressed_levels(cells, response)]
    return found


# Place of a frame under its lights, measured on untouched skin: for skin that shows no pattern.
#
# A field that is displaced by s shows untouched skin, divided by the reference, as log I = γ - s·∇ log R: the lights'
# own gradient over the field measures s. What is pressed disturbs it, far beyond its contact; by how much is estimated
# from how well the untouched cells obey that law, against how well the calibration's presses do.

POSITION: Final = "light position"
ROUNDS: Final = 4
OUTLIER: Final = 3.0
MIN_SCATTER: Final = 0.001
"""Cells beyond so many standard deviations are left out; scatter below this is the camera's own."""

SAFETY: Final = 3.0
"""Multiple of the presses' largest displacement, grown by the frame's scatter, that counts as none."""

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
        """Length of the displacement."""
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
        """Return the model from log light of the reference in cells (h, w, 3) and the presses' log intensity."""
        cell_px = columns / rest.shape[1]
        gradient = np.stack([np.gradient(rest, axis=axis) for axis in (1, 0)], axis=-1) / cell_px
        flat = gradient.reshape(-1, 3, 2).astype(np.float64)
        found = (_shift(cells, flat) for cells in presses)
        return cls(flat, tuple(shift for shift in found if shift is not None), columns)

    def check(self, cells: Float32Array, tolerance_px: float) -> FrameCheck:
        """Return the check of a frame's log intensity in cells; `tolerance_px` may always be off."""
        shift = _shift(cells, self.gradient)
        if shift is None or not self.presses:
            return not_checked(POSITION, "too little untouched skin to show the distribution of the light")
        limit = tolerance_px + SAFETY * max(press.distance_px * self._worse(shift, press) for press in self.presses)
        if limit > MAX_LIMIT * self.columns:
            return not_checked(
                POSITION, f"displacements below {limit:.0f} px cannot be distinguished from what is pressed"
            )
        if shift.distance_px <= limit:
            return FrameCheck(POSITION, "passed", shift.distance_px, limit, "px")
        words = (
            f"its light is about {shift.columns_px:+.0f} columns and {shift.rows_px:+.0f} rows off the "
            f"reference's, {shift.distance_px:.0f} px (at most {limit:.0f} px): camera or lights moved"
        )
        return FrameCheck(POSITION, "refused", shift.distance_px, limit, "px", words)

    def _worse(self, shift: LightShift, press: LightShift) -> float:
        """Return the standard uncertainty of a displacement relative to a press's; at least 1."""
        scatter = shift.scatter / press.scatter
        return max(scatter * float(np.sqrt(press.fraction / shift.fraction)), 1.0)


def _shift(cells: Float32Array, gradient: Float64Array) -> LightShift | None:
    """Return the displacement that untouched cells show; None where too few agree."""
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


def _limited(name: str, value: float, limit: float, unit: str, what: str) -> FrameCheck:
    """Return the check of a value that may be as large as its limit."""
    if value > limit:
        return FrameCheck(name, "refused", value, limit, unit, f"{what} {value:.0%} (at most {limit:.0%})")
    return FrameCheck(name, "passed", value, limit, unit)
