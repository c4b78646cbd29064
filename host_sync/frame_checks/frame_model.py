"""Properties that the frames of a calibration share, and their check on another frame.

Limits are not chosen for a device: they are what the calibration's own presses show, each compared with the reference
as a scan is, and a margin below which heights stay useful.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from device.balls.sphere import Ball, gather_samples
from device.errors import CalibrationError
from device.imaging.flat_field import LinearFrame, NormalizedImage, flat_field_correct
from device.surface import Float32Array
from host_sync.frame_checks.layout_check import LayoutModel, Turn, turns_of
from host_sync.frame_checks.level_check import MAX_REACH, LevelModel, LightPositionModel, change_below
from host_sync.frame_checks.light_levels import SlopeResponse, cell_logs
from host_sync.frame_checks.pigment_pattern import PatternSight, ReferencePattern
from host_sync.results.record import FrameCheck, not_checked


@dataclass(frozen=True, slots=True, eq=False)
class FrameModel:
    """The pattern of the skin, the levels of the lights, their layout over the field, and its place under them."""

    pattern: PatternModel
    levels: LevelModel
    layout: LayoutModel
    position: LightPositionModel

    @classmethod
    def of(
        cls,
        reference: LinearFrame | None,
        flat_field: Float32Array,
        presses: Sequence[tuple[NormalizedImage, Sequence[Ball]]],
    ) -> FrameModel:
        """Return the model of a calibration.

        reference : frame of the untouched skin, None without one
        flat_field : float32 array of shape (H, W, 3), what frames are divided by
        presses : intensity of each calibration press, and the training balls
        """
        images = [image for image, _ in presses]
        own = flat_field_correct(reference, flat_field) if reference is not None else None
        cells = [cell_logs(image) for image in images]
        layout = LayoutModel.of(flat_field)
        return cls(
            PatternModel.of(own, flat_field, images),
            LevelModel.of(cells, _response(presses)),
            layout,
            LightPositionModel.of(layout.rest, cells, flat_field.shape[1]),
        )

    @property
    def blind(self) -> tuple[str, ...]:
        """Properties that cannot be checked on frames of this calibration, a sentence each."""
        found = []
        if not self.pattern.identifiable:
            found.append(
                "frames cannot be checked for another gel, a shift or focus: the calibration's presses show no pattern "
                "of the skin that a reference frame has too"
            )
        if self.levels.reach > MAX_REACH:
            found.append(
                f"frames without untouched skin cannot be checked for {change_below(self.levels.reach)}: "
                "the calibration's own presses differ as much"
            )
        return tuple(found)

    def check(self, intensity: NormalizedImage, flat_field: Float32Array) -> tuple[FrameCheck, ...]:
        """Return every check of a frame under the calibration's flat field.

        They are in the order in which reasons explain each other.
        """
        cells = cell_logs(intensity)
        position, sharpness = self.pattern.check(intensity, flat_field)
        if position.outcome == "refused":
            # Of a foreign or displaced frame neither layout nor levels say anything.
            return position, sharpness
        seen = position.outcome == "passed" and self.pattern.identifiable
        layout = self.layout.check(cells, pattern_seen=seen)
        if layout.outcome == "refused":
            return position, sharpness, layout
        levels = self.levels.check(cells)
        if seen:
            return position, sharpness, layout, levels
        return position, sharpness, layout, levels, self.position.check(cells, self.pattern.free_tolerance_px)


def _response(presses: Sequence[tuple[NormalizedImage, Sequence[Ball]]]) -> SlopeResponse | None:
    balls = [ball for _, some in presses for ball in some]
    try:
        samples = gather_samples(presses)
    except CalibrationError:
        return None
    return SlopeResponse.of(samples, balls, presses[0][0].shape)


# Refuses a frame in which the skin's pattern is missing, displaced, turned or blurred.

POSITION: Final = "pattern position"
SHARPNESS: Final = "pattern sharpness"

SIGNIFICANT: Final = 6.0
"""Standard deviations from which a correlation peak is one; chance stays under five over all shifts searched."""

CLEAR: Final = 8.0
"""Presses that show the pattern by so many determine how far skin moves."""

IDENTIFIABLE: Final = 12.0
"""A frame without the pattern is not of this skin, if every press of the calibration shows it by so many."""

MIN_TOLERANCE_PX: Final = 2.0
TOLERANCE_OF_WIDTH: Final = 0.002
"""The pattern may lie beside its place by the larger of the two, and by twice what the presses show: skin moves."""

MIN_STRENGTH: Final = 0.4
"""Fraction of the weakest press's amplitude below which the pattern counts as missing."""

UNCLEAR: Final = "the calibration's presses do not show the reference's pattern clearly"
MAX_BLUR_PX: Final = 1.0
BLURS_PX: Final = (0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0)
"""Gaussians with which a press is blurred to learn how the pattern's amplitudes fall."""


@dataclass(frozen=True, slots=True, eq=False)
class PatternModel:
    """The reference's pattern and how the calibration's presses show it.

    reference : None where there is no reference frame
    presses : of the calibration
    strength : amplitudes (fine, coarse) that presses have, medians
    columns : width of the field, pixels
    fall : how many times the ratio of the fine to the coarse amplitude falls under each of `BLURS_PX`
    """

    reference: ReferencePattern | None
    presses: tuple[PatternSight, ...]
    strength: tuple[float, float]
    fall: tuple[float, ...]
    columns: int

    @classmethod
    def of(
        cls, reference: NormalizedImage | None, flat_field: Float32Array, presses: Sequence[NormalizedImage]
    ) -> PatternModel:
        """Return the model from the reference's own intensity and that of the calibration's presses."""
        if reference is None or min(reference.shape) < 64:
            return cls(None, (), (1.0, 1.0), (), flat_field.shape[1])
        pattern = ReferencePattern.of(reference, flat_field)
        lights = [pattern.light(press, flat_field) for press in presses]
        sights = tuple(pattern.correlate(light).peak(pattern.reach_px) for light in lights)
        shown = [i for i, sight in enumerate(sights) if sight.sigmas >= SIGNIFICANT]
        if not shown:
            return cls(pattern, sights, (1.0, 1.0), (), flat_field.shape[1])
        fine, coarse = (float(np.median([getattr(sights[i], band) for i in shown])) for band in ("fine", "coarse"))
        clearest = max(shown, key=lambda i: sights[i].sigmas)
        return cls(
            pattern, sights, (fine, coarse), _fall(pattern, lights[clearest], sights[clearest]), flat_field.shape[1]
        )

    @property
    def identifiable(self) -> bool:
        """True if every press of the calibration shows the reference's pattern beyond doubt."""
        return bool(self.presses) and min(sight.sigmas for sight in self.presses) >= IDENTIFIABLE

    @property
    def free_tolerance_px(self) -> float:
        """Least tolerance of the pattern's place, however little the presses move it."""
        return max(MIN_TOLERANCE_PX, TOLERANCE_OF_WIDTH * self.columns)

    @property
    def tolerance_px(self) -> float:
        """Tolerance of the pattern's place."""
        assert self.reference is not None  # noqa: S101 - asked only where there is one
        shown = [sight.distance_px for sight in self.presses if sight.sigmas >= CLEAR]
        return min(self.free_tolerance_px + 2.0 * max(shown, default=0.0), self.reference.reach_px)

    def check(self, intensity: NormalizedImage, flat_field: Float32Array) -> tuple[FrameCheck, FrameCheck]:
        """Return the checks of a frame's pattern: where it lies, and how sharp it is."""
        if self.reference is None:
            why = "there is no reference frame, or it is too small, whose pattern could be looked for"
            return not_checked(POSITION, why), not_checked(SHARPNESS, why)
        light = self.reference.light(intensity, flat_field)
        correlation = self.reference.correlate(light)
        here = correlation.peak(self.tolerance_px)
        anywhere = correlation.peak(self.reference.reach_px)
        if here.sigmas >= SIGNIFICANT and here.sigmas >= 0.5 * anywhere.sigmas:
            return self._at_its_place(here)
        if not self.presses:
            return not_checked(POSITION, UNCLEAR), not_checked(SHARPNESS, UNCLEAR)
        unseen = not_checked(SHARPNESS, "the reference's pattern is not seen at its place")
        if anywhere.sigmas >= (SIGNIFICANT if self.identifiable else IDENTIFIABLE):
            words = (
                f"the skin's pattern is {anywhere.column_px:+d} columns and {anywhere.row_px:+d} rows off the "
                f"reference's, {anywhere.distance_px:.0f} px (at most {self.tolerance_px:.0f} px): camera or gel moved"
            )
            return self._displaced(anywhere.distance_px, words), unseen
        turn = self._turn(light) if max(sight.sigmas for sight in self.presses) >= IDENTIFIABLE else None
        if turn is not None:
            return self._displaced(None, f"the skin's pattern is the reference's {turn.name}"), unseen
        if not self.identifiable:
            return not_checked(POSITION, UNCLEAR), unseen
        return self._missing(here), unseen

    def _at_its_place(self, sight: PatternSight) -> tuple[FrameCheck, FrameCheck]:
        """Return the checks of a pattern that lies where the reference's does."""
        position = FrameCheck(POSITION, "passed", sight.distance_px, self.tolerance_px, "px")
        sharpness = self._sharpness(sight)
        weakest = min((self._strength(press) for press in self.presses), default=0.0)
        if sharpness.outcome != "refused" and self.identifiable and self._strength(sight) < MIN_STRENGTH * weakest:
            return self._missing(sight), sharpness
        return position, sharpness

    def _missing(self, sight: PatternSight) -> FrameCheck:
        strength, weakest = self._strength(sight), min(self._strength(press) for press in self.presses)
        words = (
            f"the pattern of the reference's skin is missing in it: {max(strength, 0.0):.0%} of the strength that the "
            f"calibration's presses show (at least {MIN_STRENGTH * weakest:.0%}): another gel, another device, far out "
            "of focus, or compressed with loss"
        )
        return FrameCheck(POSITION, "refused", strength, MIN_STRENGTH * weakest, "of the presses' strength", words)

    def _displaced(self, distance_px: float | None, words: str) -> FrameCheck:
        return FrameCheck(POSITION, "refused", distance_px, self.tolerance_px, "px", words)

    def _strength(self, sight: PatternSight) -> float:
        """Return the amplitude against the median press's, the mean of both bands weighted by their precision."""
        parts = ((sight.fine, sight.fine_sigma, self.strength[0]), (sight.coarse, sight.coarse_sigma, self.strength[1]))
        weight = [(usual / sigma) ** 2 for _, sigma, usual in parts]
        return sum(w * value / usual for w, (value, _, usual) in zip(weight, parts, strict=True)) / sum(weight)

    def _turn(self, light: Float32Array) -> Turn | None:
        """Return the turn under which the pattern is the reference's, if there is one."""
        assert self.reference is not None  # noqa: S101 - asked only where there is one
        limit = SIGNIFICANT if self.identifiable else IDENTIFIABLE
        for turn in turns_of(light.shape):
            turned = np.ascontiguousarray(turn.of(light))
            if self.reference.correlate(turned).peak(self.reference.reach_px).sigmas >= limit:
                return turn
        return None

    def _sharpness(self, sight: PatternSight) -> FrameCheck:
        """Return whether the pattern is blurred against the presses'."""
        if not self.fall or not self.identifiable:
            return not_checked(SHARPNESS, UNCLEAR)
        usual = self.strength[0] / self.strength[1]
        spread = [np.log(press.fine / press.coarse / usual) for press in self.presses]
        sigma = np.hypot(sight.fine_sigma / max(sight.fine, 1e-6), sight.coarse_sigma / max(sight.coarse, 1e-6))
        # The presses' own spread and this frame's noise are given away before blur is called so.
        given = 2.0 * float(sigma) + max(0.0, -float(min(spread)))
        ratio = max(sight.fine, 1e-3 * sight.coarse) / max(sight.coarse, 1e-6) / usual
        blur_px = self._blur_px(ratio * float(np.exp(given)))
        if blur_px <= MAX_BLUR_PX:
            return FrameCheck(SHARPNESS, "passed", self._blur_px(ratio), MAX_BLUR_PX, "px")
        words = (
            f"it is blurred: the skin's pattern is smoothed as by a Gaussian of {self._blur_px(ratio):.1f} px against "
            f"the calibration's presses (at most {MAX_BLUR_PX:.1f} px): out of focus, moved, scaled, or compressed "
            "with loss"
        )
        return FrameCheck(SHARPNESS, "refused", self._blur_px(ratio), MAX_BLUR_PX, "px", words)

    def _blur_px(self, ratio: float) -> float:
        """Return the Gaussian that lowers fine over coarse amplitude to this ratio; 0 for a ratio of one and more."""
        falling = np.minimum.accumulate(np.array(self.fall))
        return float(np.interp(-ratio, -falling, BLURS_PX))


def _fall(pattern: ReferencePattern, light: Float32Array, sight: PatternSight) -> tuple[float, ...]:
    """Return how the ratio of a press's fine to its coarse amplitude falls under each blur, from 1."""
    ratios = []
    for blur_px in BLURS_PX:
        blurred = cv2.GaussianBlur(light, (0, 0), blur_px) if blur_px else light
        seen = pattern.correlate(np.asarray(blurred, np.float32)).peak(sight.distance_px + 0.5)
        ratios.append(max(seen.fine, 1e-6) / max(seen.coarse, 1e-6))
    return tuple(ratio / ratios[0] for ratio in ratios)
