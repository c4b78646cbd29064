"""Properties that the frames of a calibration share, and their check on another frame.

Limits are not chosen for a device: they are what the calibration's own presses show, each compared with the reference
as a scan is, and a margin below which heights stay useful.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from device.balls.sphere import Ball, gather_samples
from device.errors import CalibrationError
from device.imaging.flat_field import LinearFrame, NormalizedImage, flat_field_correct
from device.surface.fields import Float32Array
from host_sync.frame_checks.layout_check import LayoutModel
from host_sync.frame_checks.level_check import MAX_REACH, LevelModel, LightPositionModel
from host_sync.frame_checks.light_levels import SlopeResponse, cell_logs
from host_sync.frame_checks.pattern_check import PatternModel
from host_sync.results.record import FrameCheck


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
                "frames cannot be checked for another gel or for focus: the calibration's presses show no pattern of "
                "the skin that a reference frame has too"
            )
        if self.levels.reach > MAX_REACH:
            found.append(
                f"frames without untouched skin cannot be checked for lights that differ by less than "
                f"{self.levels.reach:.0%}: the calibration's own presses differ that much"
            )
        return tuple(found)

    def check(self, intensity: NormalizedImage, flat_field: Float32Array) -> tuple[FrameCheck, ...]:
        """Return every check of a frame under the calibration's flat field, in the order in which reasons explain each
        other."""
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
