"""State of lights, skin and gel under one calibration, measured between presses and at each press."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from device.errors import DeviceError
from device.guidance.guide import GuideModel, PressMeasure, measure_frame
from device.imaging.flat_field import NormalizedImage, bin_bayer, flat_field_correct
from device.imaging.frame_light import Levels, LightShares
from device.quality.press_faults import (
    FLAT_RESIDUAL_UM,
    LIGHT_CONTACT,
    LIGHT_DRIFTED,
    MIN_CONTACT,
    STALE_EVIDENCE_SCANS,
)
from device.quality.untouched import LightDriftMonitor, ReferenceModel, UntouchedRegion, gel_defects
from device.quality.verdict import InstrumentContext
from device.quick_look.solver import QuickLookModel, quick_look
from device.store.choices import count_gel_press
from device.surface import Float32Array, MaskArray
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

    `guide_model` is the press guide's, by which scans are judged too.
    """

    def __init__(self, reference: RawFrame, model: QuickLookModel, profile: BoardProfile, root: Path) -> None:
        binned = bin_bayer(reference, model.binning)
        self._model = model
        self._profile = profile
        self._root = root
        self._reference = ReferenceModel.of(flat_field_correct(binned, model.flat_field))
        self.guide_model = GuideModel.prepare(
            reference,
            model.slopes,
            model.pitch_um,
            1e3 * profile.gel.slab_thickness_mm,
            tuple(light.name for light in profile.lights),
        )
        self._shares: LightShares | None = None
        self._drift = LightDriftMonitor()
        self.defects: MaskArray = gel_defects(binned)

    @property
    def light_change(self) -> dict[str, float | None]:
        """Relative change of each light since calibration; None without a recent measurement."""
        stale = self._drift.unseen_scans > STALE_EVIDENCE_SCANS
        return self._by_name(None if stale else self._drift.changes)

    @property
    def channel_levels(self) -> Levels:
        """Intensity of untouched skin in R, G and B, as last measured; 1 as calibrated or not measured."""
        changes = self._drift.changes
        if changes is None or self._shares is None:
            return 1.0, 1.0, 1.0
        return self._shares.channels([1.0 + change for change in changes])

    @property
    def knows_shares(self) -> bool:
        """True if each light was measured alone under this calibration; before, no light level is known."""
        return self._shares is not None

    def light_change_since(self, at_ns: int) -> dict[str, float | None]:
        """Return relative change of each light, measured on untouched skin after that time (ns); None without one."""
        return self._by_name(self._drift.changes_since(at_ns))

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

    def measure_shares(self, alone: Sequence[RawFrame], dark: RawFrame) -> bool:
        """Measure the lights' shares from frames under each light alone and under none; returns whether that worked.

        It fails while something touches the skin, and with a light that is out.
        """
        ratios = [self._reference.ratio(self._intensity(frame)) for frame in (*alone, dark)]
        self._shares = LightShares.measure(ratios[:-1], ratios[-1])
        return self._shares is not None

    def take_channels_for_lights(self) -> None:
        """Take each channel for the light of its colour: of lights that cannot be switched, none is seen alone."""
        self._shares = LightShares.by_channel()

    def update(self, frame: RawFrame) -> bool:
        """Measure lights and defects in a live frame; returns whether the whole skin was untouched."""
        if self._shares is None:
            return False
        binned = bin_bayer(frame, self._model.binning)
        region = self._reference.detect(flat_field_correct(binned, self._model.flat_field), self._shares)
        if not self._drift.update(region, frame.sensor_timestamp_ns):
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
        look = quick_look(binned, replace(self._model, rest=None))  # no prior: flatness is what is measured
        region = self._reference.assume_untouched(look.intensity, self._shares)
        detected = self._reference.detect(look.intensity, self._shares)
        flat_um, defects = flatness_um(look.height.z_um), gel_defects(binned)
        if flat_um <= FLAT_RESIDUAL_UM or (detected is not None and detected.is_whole):
            if self._shares:
                self._drift.update(region, frame.sensor_timestamp_ns)
            self.defects = defects
        red, green, blue = (level - 1.0 for level in region.levels)
        return ZeroCheck(flat_um, (red, green, blue), region.pattern, float(defects.mean()))

    def measure_press(self, frame: RawFrame) -> PressMeasure:
        """Return contact and depth in a frame, as the guide measures them."""
        return measure_frame(frame, self.guide_model, self.channel_levels)

    def context_of_scan(
        self, frame: RawFrame, intensity: NormalizedImage | None, motion: float | None
    ) -> InstrumentContext:
        """Context for the verdict on a scan; also measures the lights in its frame and counts the gel's press."""
        region = self._reference.detect(intensity, self._shares) if intensity else None
        press = PressMeasure() if intensity is None else self.measure_press(frame)
        lights = self._lights_of_scan(intensity, region)
        self._drift.update_from_scan(lights)
        return InstrumentContext(
            motion=motion,
            light_change=self._by_name(_changes(lights) if lights else self._drifted()),
            reference_change=self.reference_change,
            defect_fraction=self.defect_fraction,
            gel_presses=self._count_press(),
            contact_fraction=press.contact_fraction,
            covers_field=_covers_field(press, region),
            depth_fraction=press.depth_fraction,
            tilt_deg=press.tilt_deg,
            tilt_towards=press.tilt_towards,
        )

    def _lights_of_scan(self, intensity: NormalizedImage | None, region: UntouchedRegion | None) -> Levels | None:
        """Return levels of the lights that a scan's own frame proves; None if it does not."""
        if intensity is None or self._shares is None:
            return None
        if region is not None and region.is_whole and not region.is_tilt:
            return region.levels
        return self._reference.lights_beside_press(intensity, self._shares)

    def _drifted(self) -> Levels | None:
        """Return the last measured changes of the lights if one of them is too large, else None.

        Such a change counts until untouched skin shows otherwise.
        """
        changes = self._drift.changes
        return changes if changes and max(abs(change) for change in changes) > LIGHT_DRIFTED else None

    def _by_name(self, changes: Levels | None) -> dict[str, float | None]:
        names = [light.name for light in self._profile.lights]
        return dict.fromkeys(names) if changes is None else dict(zip(names, changes, strict=True))

    def _intensity(self, frame: RawFrame) -> NormalizedImage:
        return flat_field_correct(bin_bayer(frame, self._model.binning), self._model.flat_field)

    def _count_press(self) -> int | None:
        """Return presses of this gel including this one; a count that cannot be stored must not cost a scan."""
        try:
            return count_gel_press(self._root, self._profile.gel).presses
        except DeviceError:
            return None


def _covers_field(press: PressMeasure, region: UntouchedRegion | None) -> bool:
    """Return whether a gentle object covers the whole field.

    Little relief then stands out, and yet the field is not untouched.
    """
    fraction = press.contact_fraction
    if fraction is None or fraction >= LIGHT_CONTACT:
        return False
    return region is None or (fraction < MIN_CONTACT and not region.is_whole)


def _changes(levels: Levels) -> Levels:
    red, green, blue = (level - 1.0 for level in levels)
    return red, green, blue


def flatness_um(z_um: Float32Array) -> float:
    """Rms of heights (µm, shape (H, W)) about their mean plane."""
    down, across = (np.linspace(-1.0, 1.0, size, dtype=np.float32) for size in z_um.shape)
    level = z_um - z_um.mean()
    level = level - across * (level * across).mean() / (across * across).mean()
    column = down[:, None]
    level = level - column * (level * column).mean() / (column * column).mean()
    return float(level.std())
