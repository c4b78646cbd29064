"""What a scanner knows of lights, skin and gel beside the frame it judges, gathered between presses and at each."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from device.drift_watch import DriftWatch
from device.errors import DeviceError
from device.gel_defects import gel_defects
from device.gel_log import count_gel_press
from device.health_limits import FLAT_RESIDUAL_UM, STALE_EVIDENCE_SCANS
from device.photometry import IntensityImage, bin_bayer, divide
from device.quick_look import QuickLook, QuickLookModel, quick_look
from device.rest_sight import RestModel
from device.surface import Float32Array, MaskArray
from device.verdict import Circumstances
from hal.board_profile import BoardProfile
from hal.frame import RawFrame


@dataclass(frozen=True, slots=True)
class ZeroCheck:
    """A frame of untouched skin: how flat it reads (root mean square of its heights, µm), and over what share."""

    flat_residual_um: float
    changes: tuple[float, float, float]
    pattern: float
    defect_share: float


class ScanHealth:
    """Lights, skin and gel under one calibration.

    Parameters
    ----------
    reference : the calibration's, in sensor pixels
    model : the calibration at quick-look size
    root : of the store, which counts the gel's presses
    """

    def __init__(self, reference: RawFrame, model: QuickLookModel, profile: BoardProfile, root: Path) -> None:
        binned = bin_bayer(reference, model.binning)
        self._model = model
        self._profile = profile
        self._root = root
        self._rest = RestModel.of(divide(binned, model.divisor))
        self._watch = DriftWatch()
        self.defects: MaskArray = gel_defects(binned)

    @property
    def light_change(self) -> dict[str, float | None]:
        """Change of each light since calibration; None when untouched skin was not seen, or not for long."""
        changes = self._watch.changes
        if changes is None or self._watch.unseen_scans > STALE_EVIDENCE_SCANS:
            return {light.name: None for light in self._profile.lights}
        return {light.name: change for light, change in zip(self._profile.lights, changes, strict=True)}

    @property
    def reference_change(self) -> float | None:
        """Change of the resting skin's pattern since calibration, root mean square; None before it was seen."""
        return self._watch.pattern

    @property
    def unseen_scans(self) -> int:
        """Scans since untouched skin was last seen."""
        return self._watch.unseen_scans

    @property
    def defect_share(self) -> float:
        """Share of the field under defects."""
        return float(self.defects.mean())

    def look(self, frame: RawFrame) -> bool:
        """Look at a live frame between presses; says whether the whole skin was seen at rest."""
        binned = bin_bayer(frame, self._model.binning)
        sight = self._rest.see(divide(binned, self._model.divisor))
        if sight is None or not sight.is_whole or not self._watch.see(sight):
            return False
        self.defects = gel_defects(binned)
        return True

    def check_zero(self, frame: RawFrame) -> ZeroCheck:
        """What a frame says that somebody vouches for as untouched. One that is neither flat nor looks at rest is
        touched all the same: lights and skin are not judged by it.

        Raises
        ------
        CalibrationMismatch
            The frame is not of the calibration's size.
        """
        binned = bin_bayer(frame, self._model.binning)
        look = quick_look(binned, self._model)
        sight, at_rest = self._rest.trust(look.intensity), self._rest.see(look.intensity)
        flat_um, defects = flatness_um(look.height.z_um), gel_defects(binned)
        if flat_um <= FLAT_RESIDUAL_UM or (at_rest is not None and at_rest.is_whole):
            self._watch.see(sight)
            self.defects = defects
        red, green, blue = (level - 1.0 for level in sight.levels)
        return ZeroCheck(flat_um, (red, green, blue), sight.pattern, float(defects.mean()))

    def circumstances(
        self, intensity: IntensityImage | None, look: QuickLook | None, motion: float | None
    ) -> Circumstances:
        """What the verdict on a scan may know; the scan's own frame is a sight too, and one more press of the gel."""
        sight = self._rest.see(intensity) if intensity else None
        self._watch.scanned(sight)
        return Circumstances(
            at_rest=None if intensity is None else sight is not None and sight.is_whole,
            motion=motion,
            light_change=self.light_change,
            reference_change=self.reference_change,
            defect_share=self.defect_share,
            gel_presses=self._count_press(),
            depth_share=self._depth_share(look),
        )

    def _count_press(self) -> int | None:
        """Presses of this gel, this one included; a count that cannot be stored never costs a scan."""
        try:
            return count_gel_press(self._root, self._profile.gel).presses
        except DeviceError:
            return None

    def _depth_share(self, look: QuickLook | None) -> float | None:
        if look is None:
            return None
        raised = look.height.z_um
        low, top = (float(value) for value in np.percentile(raised[::2, ::2], (5.0, 99.5)))
        return (top - low) * 1e-3 / self._profile.gel.slab_thickness_mm


def flatness_um(z_um: Float32Array) -> float:
    """Root mean square of heights (µm, shape (H, W)) about their mean plane."""
    down, across = (np.linspace(-1.0, 1.0, size, dtype=np.float32) for size in z_um.shape)
    level = z_um - z_um.mean()
    level = level - across * (level * across).mean() / (across * across).mean()
    column = down[:, None]
    level = level - column * (level * column).mean() / (column * column).mean()
    return float(level.std())
