"""Presses as the models are fitted to them: balls located, without noise, their light against the reference."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from device.balls.detector import RejectedBall
from device.balls.sphere import Ball, gather_samples
from device.errors import CalibrationError
from device.imaging.flat_field import LinearFrame, NormalizedImage, flat_field_correct
from device.imaging.frame_light import FrameLight
from device.inverse_map.near_light import IlluminationMap
from device.inverse_map.skin_at_rest import SkinAtRest
from device.surface import Float32Array
from host_sync.calibration.balls import FittedBall, PressFrame, UsedPress, check_distinct, check_sizes
from host_sync.calibration.consistency import check_reference
from host_sync.calibration.located_presses import flat_field_of, locate_all
from host_sync.calibration.pixel_pitch import PixelPitch
from host_sync.denoising.bounded_shrinkage import DetailShrinkage, learn_shrinkage
from host_sync.frame_checks.frame_model import FrameModel
from host_sync.frame_checks.level_check import is_light


@dataclass(frozen=True, slots=True, eq=False)
class PreparedPresses:
    """Presses of a calibration, and what they show before a slope is read.

    frames : the presses as they were given
    reference : frame of untouched skin; None without one
    flat_field : float32 array of shape (H, W, 3), what frames are divided by
    located : the presses with their balls, without noise
    measured_pitch : as grids among them measure it; None without grids
    stated_um : pixel pitch as stated
    frame_model : what the frames have in common
    at_rest : how the light of untouched skin differs from frame to frame; None without a reference
    lights : of the presses
    shrinkage : of the frames' noise; None where noise and detail cannot be separated
    """

    frames: Sequence[PressFrame]
    reference: LinearFrame | None
    flat_field: Float32Array
    located: Sequence[UsedPress]
    measured_pitch: PixelPitch | None
    stated_um: float
    frame_model: FrameModel
    at_rest: SkinAtRest | None
    lights: tuple[FrameLight, ...]
    shrinkage: DetailShrinkage | None

    @classmethod
    def of(
        cls,
        presses: Sequence[PressFrame],
        reference: LinearFrame | None,
        stated_um: float,
        others: Sequence[LinearFrame],
        report_progress: Callable[[str], None],
    ) -> PreparedPresses:
        """Check and prepare presses; arguments and errors as for `calibrate`."""
        if not presses:
            raise CalibrationError("there is no calibration press: press a ball of known radius into the gel")
        check_sizes(presses, reference)
        check_distinct(presses)
        if reference is not None:
            check_reference(reference)
        report_progress("flat-field correction")
        flat_field = flat_field_of([*(press.frame for press in presses), *others], reference)
        report_progress("finding balls")
        located, pitch = locate_all(presses, flat_field, stated_um, reference)
        frame_model = FrameModel.of(reference, flat_field, pressed(located))
        report_progress("measuring the frames' noise")
        at_rest = SkinAtRest.of(pressed(located), flat_field) if reference else None
        lights = _lights(located, at_rest)
        level = [flat_field_correct(reference, flat_field)] if reference else [press.intensity for press in located]
        samples = gather_samples(pressed(located))
        shrinkage = learn_shrinkage(pressed(located), samples, [image.values for image in level])
        if shrinkage is not None:
            located = [replace(press, intensity=shrinkage.shrunk(press.intensity)) for press in located]
        return cls(
            presses, reference, flat_field, located, pitch, stated_um, frame_model, at_rest, lights, shrinkage
        )  # fmt: skip

    @property
    def pitch_um(self) -> float:
        """Distance of neighbouring pixels on the skin, µm, measured where it was."""
        return self.measured_pitch.pitch_um if self.measured_pitch else self.stated_um

    @property
    def illumination(self) -> IlluminationMap | None:
        """Light of untouched skin over the field; None without a reference."""
        return IlluminationMap.of(self.flat_field) if self.reference else None


def pressed(presses: Sequence[UsedPress]) -> list[tuple[NormalizedImage, Sequence[Ball]]]:
    """Return the intensity and the balls of each press."""
    return [(press.intensity, press.balls) for press in presses]


def in_reference_light(
    presses: Sequence[UsedPress], lights: Sequence[FrameLight], flat_field: Float32Array
) -> Sequence[UsedPress]:
    """Return presses without the gains and offsets that they have."""
    found = []
    for press, light in zip(presses, lights, strict=True):
        values = press.intensity.values.copy()
        light.take_out(values, flat_field)
        found.append(replace(press, intensity=replace(press.intensity, values=values)))
    return found


def _lights(presses: Sequence[UsedPress], at_rest: SkinAtRest | None) -> tuple[FrameLight, ...]:
    """Return the light of each press; unchanged where none shows, or one that no light has."""
    found = []
    for press in presses:
        evidence = None if at_rest is None else at_rest.evidence(press.intensity)
        known = evidence is not None and evidence.has_rest and is_light(evidence.light)
        found.append(evidence.light if evidence is not None and known else FrameLight.unchanged())
    return tuple(found)


# The presses of a calibration as it keeps them: without their frames, some with a small picture for the report.

MAX_SHOWN: Final = 48
"""At most so many presses keep a picture."""

MAX_WIDTH_PX: Final = 1500
"""Width of all pictures of a row together."""


@dataclass(frozen=True, slots=True, eq=False)
class TrainingPress:
    """A press after calibration.

    shape : (H, W) of its frame
    balls, rejected, error, source, fitted : as in `UsedPress`
    picture : uint8 array of shape (h, w, 3), its intensity reduced, flat skin mid-grey; None where none is shown
    """

    name: str
    shape: tuple[int, int]
    balls: tuple[Ball, ...]
    rejected: tuple[RejectedBall, ...]
    error: str
    source: str
    fitted: tuple[FittedBall, ...]
    picture: NDArray[np.uint8] | None


def training_presses(presses: Sequence[UsedPress]) -> tuple[TrainingPress, ...]:
    """Return the presses with pictures of `MAX_SHOWN` of them at most."""
    shown = _chosen(presses)
    width_px = MAX_WIDTH_PX // pictures_across(len(shown))
    return tuple(
        TrainingPress(
            name=press.name,
            shape=press.intensity.shape,
            balls=press.balls,
            rejected=press.rejected,
            error=press.error,
            source=press.source,
            fitted=press.fitted,
            picture=_picture(press.intensity.values, width_px) if number in shown else None,
        )
        for number, press in enumerate(presses)
    )


def pictures_across(count: int) -> int:
    """Return pictures in a row of `count` in all."""
    return int(np.ceil(np.sqrt(count)))


def _chosen(presses: Sequence[UsedPress]) -> list[int]:
    """Return numbers of at most `MAX_SHOWN` presses: those with rejected balls first, the rest spread evenly."""
    rejected_ones = [i for i, press in enumerate(presses) if press.rejected or press.error][:MAX_SHOWN]
    clean = [i for i in range(len(presses)) if i not in rejected_ones]
    room = MAX_SHOWN - len(rejected_ones)
    spread = [clean[i * len(clean) // room] for i in range(room)] if len(clean) > room else clean
    return sorted(rejected_ones + spread)


def _picture(values: Float32Array, max_width_px: int) -> NDArray[np.uint8]:
    """Return the intensity as a picture: flat skin mid-grey, slightly compressed."""
    factor = max(1, values.shape[1] // max_width_px)
    if factor > 1:
        size = (values.shape[1] // factor, values.shape[0] // factor)
        values = np.asarray(cv2.resize(values, size, interpolation=cv2.INTER_AREA), np.float32)
    return np.asarray(np.rint(255.0 * np.clip(0.45 * np.nan_to_num(values), 0.0, 1.0) ** 0.8), np.uint8)
