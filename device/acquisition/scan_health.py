"""State of lights, skin and gel under one calibration, measured between presses and at each press."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from device.errors import DeviceError
from device.imaging.flat_field import NormalizedImage, bin_bayer, flat_field_correct
from device.quality.thresholds import FLAT_RESIDUAL_UM, STALE_EVIDENCE_SCANS
from device.quality.untouched import LightDriftMonitor, ReferenceModel, gel_defects
from device.quality.verdict import InstrumentContext
from device.quick_look.solver import QuickLook, QuickLookModel, quick_look
from device.store.gels import count_gel_press
from device.surface.fields import Float32Array, MaskArray
from hal.board_profile import BoardProfile
from hal.frame import RawFrame


@dataclass(frozen=True, slots=True)
class ZeroCheck:
    """A frame of untouched skin: rms of its heights (µm), light changes, pattern change, fraction with defects."""

    flat_residual_um: float
    changes: tuple[float, float, float]
    pattern: float
    defect_fraction: float


class ScanHealth:
    """Lights, skin and gel under one calibration.

    Parameters
    ----------
    reference : of the calibration, in sensor pixels
    model : the calibration at quick-look size
    root : of the store, which counts the gel's presses
    """

    def __init__(self, reference: RawFrame, model: QuickLookModel, profile: BoardProfile, root: Path) -> None:
        binned = bin_bayer(reference, model.binning)
        self._model = model
        self._profile = profile
        self._root = root
        self._reference = ReferenceModel.of(flat_field_correct(binned, model.flat_field))
        self._drift = LightDriftMonitor()
        self.defects: MaskArray = gel_defects(binned)

    @property
    def light_change(self) -> dict[str, float | None]:
        """Relative change of each light since calibration; None without a recent measurement."""
        changes = self._drift.changes
        if changes is None or self._drift.unseen_scans > STALE_EVIDENCE_SCANS:
            return {light.name: None for light in self._profile.lights}
        return {light.name: change for light, change in zip(self._profile.lights, changes, strict=True)}

    @property
    def reference_change(self) -> float | None:
        """Rms change of the untouched skin's pattern since calibration; None before a measurement."""
        return self._drift.pattern

    @property
    def unseen_scans(self) -> int:
        """Scans since untouched skin was last measured."""
        return self._drift.unseen_scans

    @property
    def defect_fraction(self) -> float:
        """Fraction of the field with defects."""
        return float(self.defects.mean())

    def update(self, frame: RawFrame) -> bool:
        """Measure lights and defects in a live frame; returns whether the whole skin was untouched."""
        binned = bin_bayer(frame, self._model.binning)
        region = self._reference.detect(flat_field_correct(binned, self._model.flat_field))
        if region is None or not region.is_whole or not self._drift.update(region):
            return False
        self.defects = gel_defects(binned)
        return True

    def check_zero(self, frame: RawFrame) -> ZeroCheck:
        """Measure a frame that the operator states is untouched.

        A frame that neither reads flat nor looks untouched is reported but does not update lights and defects.

        Raises
        ------
        CalibrationMismatch
            The frame's size differs from the calibration's.
        """
        binned = bin_bayer(frame, self._model.binning)
        look = quick_look(binned, self._model)
        region = self._reference.assume_untouched(look.intensity)
        detected = self._reference.detect(look.intensity)
        flat_um, defects = flatness_um(look.height.z_um), gel_defects(binned)
        if flat_um <= FLAT_RESIDUAL_UM or (detected is not None and detected.is_whole):
            self._drift.update(region)
            self.defects = defects
        red, green, blue = (level - 1.0 for level in region.levels)
        return ZeroCheck(flat_um, (red, green, blue), region.pattern, float(defects.mean()))

    def context_of_scan(
        self, intensity: NormalizedImage | None, look: QuickLook | None, motion: float | None
    ) -> InstrumentContext:
        """Context for the verdict on a scan; also measures the lights in its frame and counts the gel's press."""
        region = self._reference.detect(intensity) if intensity else None
        self._drift.update_from_scan(region)
        return InstrumentContext(
            at_rest=None if intensity is None else region is not None and region.is_whole,
            motion=motion,
            light_change=self.light_change,
            reference_change=self.reference_change,
            defect_fraction=self.defect_fraction,
            gel_presses=self._count_press(),
            depth_fraction=self._depth_fraction(look),
        )

    def _count_press(self) -> int | None:
        """Presses of this gel including this one; a count that cannot be stored must not cost a scan."""
        try:
            return count_gel_press(self._root, self._profile.gel).presses
        except DeviceError:
            return None

    def _depth_fraction(self, look: QuickLook | None) -> float | None:
        if look is None:
            return None
        raised = look.height.z_um
        low, top = (float(value) for value in np.percentile(raised[::2, ::2], (5.0, 99.5)))
        return (top - low) * 1e-3 / self._profile.gel.slab_thickness_mm


def flatness_um(z_um: Float32Array) -> float:
    """Rms of heights (µm, shape (H, W)) about their mean plane."""
    down, across = (np.linspace(-1.0, 1.0, size, dtype=np.float32) for size in z_um.shape)
    level = z_um - z_um.mean()
    level = level - across * (level * across).mean() / (across * across).mean()
    column = down[:, None]
    level = level - column * (level * column).mean() / (column * column).mean()
    return float(level.std())
