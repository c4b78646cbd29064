"""Assessment of a calibration: scale, coverage, checks and notes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from device.balls.sphere import BallSamples
from device.calibration.acceptance import Check, check_fit, fit_checks
from device.calibration.coverage import Coverage, measure_coverage
from device.calibration.fit import InverseFit
from device.calibration.limits import MAX_RADIUS_SPREAD, PASSED_RESTING
from device.imaging.flat_field import NormalizedImage
from device.imaging.frame_light import FrameLight
from device.inverse_map.skin_at_rest import SkinAtRest
from host_sync.calibration.balls import PressFrame, UsedPress
from host_sync.calibration.located_presses import check_count
from host_sync.calibration.pixel_pitch import PixelPitch
from host_sync.calibration.pixel_shape import PixelShape, measure_pixel_shape
from host_sync.calibration.radii import check_radii, radius_shares, radius_spread
from host_sync.calibration.scale import ScaleUncertainty, scale_uncertainty

NOTED_NOISE: Final = 0.02
"""Relative noise of untouched skin from which a calibration states it."""

NOTED_CHANGE: Final = 0.01
NOTED_STRAY: Final = 0.005
"""Change of a light, relative, and light of the surroundings, fraction of full scale, that a person should know of."""


@dataclass(frozen=True, slots=True, eq=False)
class Assessment:
    """Scale, coverage and checks of a calibration.

    pitch : what ball grids measured, None when no press shows one of known spacing
    notes : what a person should know, one sentence each
    pixel_shape : of pixels over the stated one, None where the balls do not show it
    """

    pitch: PixelPitch | None
    scale: ScaleUncertainty
    coverage: Coverage
    checks: tuple[Check, ...]
    notes: tuple[str, ...]
    pixel_shape: PixelShape | None = None

    @property
    def passed(self) -> bool:
        """True if every check passed."""
        return all(check.passed for check in self.checks)


def assess(
    presses: Sequence[PressFrame],
    used: Sequence[UsedPress],
    training: BallSamples,
    inverse: InverseFit,
    pitch: PixelPitch | None,
    pitch_um: float,
) -> Assessment:
    """Return what a calibration is worth.

    used : the presses after the fit
    training : samples of their balls
    pitch_um : of square pixels

    Raises
    ------
    CalibrationError
        Too few balls are left, their radii contradict each other, or held-out balls are wrong.
    """
    check_count(used, pitch_um)
    shares = radius_shares(training, inverse.map)
    check_radii(shares, [press.label for press in used for _ in press.balls])
    check_fit(inverse)
    radii_px = np.array([ball.radius_px for press in used for ball in press.balls])
    coverage = measure_coverage(training, used[0].intensity.shape, inverse.map.max_trained_slope)
    shape = measure_pixel_shape(used, inverse.map)
    return Assessment(
        pitch=pitch,
        scale=scale_uncertainty(pitch, presses, shares, radii_px),
        coverage=coverage,
        checks=checks(used, inverse.held_out_deg, radius_spread(shares), coverage, shape),
        notes=(*_notes(presses, used, pitch), *_shape_note(shape, pitch_um)),
        pixel_shape=shape,
    )


def diameter_note(widest: float) -> list[str]:
    """Return the question whether a diameter was given as the radius, where no contact is wider than this fraction of
    it."""
    if widest > DIAMETER_CONTACT:
        return []
    return [
        f"no ball's contact is wider than {widest:.2f} of the stated radius: {DIAMETER_QUESTION} "
        "Heights are then half as high as the surface; else check pixel_pitch_um, or press deeper"
    ]


def _shape_note(shape: PixelShape | None, pitch_um: float) -> tuple[str, ...]:
    words = shape.disagreement(pitch_um) if shape else ""
    return (words,) if words else ()


def with_reference(assessment: Assessment, at_rest: SkinAtRest, reference: NormalizedImage) -> Assessment:
    """Return the assessment with the reference judged as a scan, and a note on the noise of untouched skin."""
    check = Check(
        "fraction of the reference that reads as skin at rest",
        at_rest.evidence(reference).fraction,
        PASSED_RESTING,
        "at least",
    )
    note = (
        f"the light of untouched skin differs by {at_rest.noise:.1%} between the presses and the reference: slopes "
        "that change it less are measured as level; better exposure, warm lights and raw frames lower it"
    )
    notes = (*assessment.notes, note) if at_rest.noise > NOTED_NOISE else assessment.notes
    return replace(assessment, checks=(*assessment.checks, check), notes=notes)


def light_notes(lights: Sequence[FrameLight]) -> tuple[str, ...]:
    """Return notes on the light of presses, which was removed."""
    notes = []
    if (change := max(light.change for light in lights)) > NOTED_CHANGE:
        notes.append(
            f"lights differed by up to {change:.1%} between the presses and the reference, which was removed: let them "
            "warm up before you calibrate"
        )
    if (stray := max(light.stray for light in lights)) > NOTED_STRAY:
        notes.append(
            f"light of the surroundings differed by up to {stray:.1%} of full scale between the presses and the "
            "reference, which was removed: shade the sensor while you calibrate"
        )
    return tuple(notes)


def _notes(presses: Sequence[PressFrame], used: Sequence[UsedPress], pitch: PixelPitch | None) -> tuple[str, ...]:
    read = {reading.press for reading in pitch.readings} if pitch else set()
    notes = [
        f"{press.label}: its balls form no square grid, so that it does not measure the pixel pitch"
        for press in presses
        if press.grid and press.label not in read
    ]
    notes += [f"{press.label} {press.error}: it is not used" for press in used if press.error]
    notes += diameter_note(widest_contact(used))
    return tuple(notes + ([pitch.disagreement] if pitch and pitch.disagreement else []))


# Verdict on a calibration: every number that decides, beside its limit.

DIAMETER_QUESTION: Final = "is ball_radius_mm the diameter?"
DIAMETER: Final = f"widest contact over the stated radius ({DIAMETER_QUESTION})"
DIAMETER_CONTACT: Final = 0.45
"""A contact reaches 0.8 of the radius at most, 0.4 of the diameter; one ring's width is added."""

PIXEL_SHAPE: Final = "pixels' height over width against the stated, by the skin around the balls"


def checks(
    presses: Sequence[UsedPress],
    held_out_deg: float | None,
    radius_spread: float,
    coverage: Coverage,
    shape: PixelShape | None = None,
) -> tuple[Check, ...]:
    """Return the checks of the report; a calibration passes when all do.

    What is rejected in a press that shows one ball is part of its dent, not another ball.
    """
    balls = sum(len(press.balls) for press in presses)
    rejected = sum(len(press.rejected) or bool(press.error) for press in presses if len(press.balls) != 1)
    first, share, *rest = fit_checks(balls, rejected, held_out_deg, coverage)
    spread = Check("relative spread of ball radii from shading", radius_spread, MAX_RADIUS_SPREAD, "at most")
    off = () if shape is None else (Check(PIXEL_SHAPE, shape.off, shape.allowed, "at most"),)
    widest = Check(DIAMETER, widest_contact(presses), DIAMETER_CONTACT, "at least")
    return (first, share, spread, widest, *off, *rest)


def widest_contact(presses: Sequence[UsedPress]) -> float:
    """Return the widest contact of any ball over its stated radius."""
    return max((ball.contact_radius_px / ball.radius_px for press in presses for ball in press.balls), default=0.0)
