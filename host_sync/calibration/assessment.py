"""Assessment of a calibration: scale, coverage, checks and notes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np

from device.balls.detector import TOO_WIDE
from device.balls.sphere import Ball, BallSamples
from device.calibration.acceptance import (
    MAX_RADIUS_SPREAD,
    PASSED_RESTING,
    Check,
    Coverage,
    check_fit,
    fit_checks,
    measure_coverage,
)
from device.calibration.fit import InverseFit
from device.imaging.flat_field import NormalizedImage
from device.imaging.frame_light import FrameLight
from device.inverse_map.model import InverseMap
from device.inverse_map.skin_at_rest import SkinAtRest
from host_sync.calibration.balls import PressFrame, UsedPress
from host_sync.calibration.located_presses import check_count
from host_sync.calibration.pixel_pitch import PixelPitch
from host_sync.calibration.radii import check_radii, radius_shares, radius_spread
from host_sync.calibration.scale import ScaleUncertainty, scale_uncertainty
from host_sync.text import some_of

NOTED_NOISE: Final = 0.02
"""Relative noise of untouched skin from which a calibration states it."""

NOTED_CHANGE: Final = 0.01
NOTED_STRAY: Final = 0.005
"""Change of a light, relative, and light of the surroundings, fraction of full scale, that a person should know of."""


NOTED_MOVE: Final = 0.3
"""Distance of a ball from where it is stated, in radii of its contact, that a person should know of."""


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
    check_count(used, pitch_um, presses[0].radius_px)
    shares = radius_shares(training, inverse.map)
    check_radii(shares, [press.label for press in used for _ in press.balls])
    check_fit(inverse)
    radii_px = np.array([ball.radius_px for press in used for ball in press.balls])
    rejected = [ball for press in used for ball in press.rejected]
    coverage = measure_coverage(training, used[0].intensity.shape, inverse.map.max_trained_slope, rejected)
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
    """Return the question whether a diameter was given as the radius; empty where a contact is wide enough.

    widest : of the contacts, as a fraction of the radius
    """
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
            "warm up, and fix exposure and white balance, before you calibrate"
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
    notes += moved_note(presses, used)
    notes += diameter_note(widest_contact(used))
    return tuple(notes + ([pitch.disagreement] if pitch and pitch.disagreement else []))


def moved_note(presses: Sequence[PressFrame], used: Sequence[UsedPress]) -> list[str]:
    """Return the note on balls that are used far from where they are stated; empty without one."""
    stated = {press.name: press.balls or () for press in presses}
    moved = [press.label for press in used if any(_is_far(ball, stated.get(press.name, ())) for ball in press.balls)]
    if not moved:
        return []
    return [
        f"{some_of(moved)}: a ball is used more than {NOTED_MOVE:g} of its contact's radius from its stated place: "
        "compare both in the calibration's picture"
    ]


def _is_far(ball: Ball, stated: Sequence[Ball]) -> bool:
    """Return whether a used ball lies far from every stated one; False where none is stated."""
    away = [np.hypot(one.column - ball.column, one.row - ball.row) for one in stated]
    return bool(away) and float(min(away)) > NOTED_MOVE * ball.contact_radius_px


# Verdict on a calibration: every number that decides, beside its limit.

DIAMETER_QUESTION: Final = "is ball_radius_mm the diameter?"
DIAMETER: Final = f"widest contact over the stated radius ({DIAMETER_QUESTION})"
DIAMETER_CONTACT: Final = 0.45
"""A contact reaches 0.8 of the radius at most, 0.4 of the diameter; one ring's width is added."""

GIVEN_TOO_WIDE: Final = "fraction of presses whose given balls look wider than radius and pixel pitch allow"
MAX_TOO_WIDE: Final = 0.1
"""It is 0 on seven labelled sets of real sensors; with twice the pitch, .28 to .97 on four, .03 and 0 on three."""

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
    fraction = fraction_too_wide(presses)
    wide = (Check(GIVEN_TOO_WIDE, fraction, MAX_TOO_WIDE, "at most"),) if fraction else ()
    return (first, share, spread, widest, *wide, *off, *rest)


def fraction_too_wide(presses: Sequence[UsedPress]) -> float:
    """Return the fraction of presses with given balls in which the skin looks wider than such a ball can press it."""
    found = [press.seen for press in presses if press.balls and press.seen is not None]
    wide = [seen for seen in found if not seen.found and any(ball.reason == TOO_WIDE for ball in seen.rejected)]
    return len(wide) / max(len(found), 1)


def widest_contact(presses: Sequence[UsedPress]) -> float:
    """Return the widest contact of any ball over its stated radius."""
    return max((ball.contact_radius_px / ball.radius_px for press in presses for ball in press.balls), default=0.0)


# The shape of pixels, height over width, that the skin around pressed balls shows.
#
# Inside a contact nothing shows it: a map learned from balls that are stretched with the frame reads stretched slopes.
# Around the contact the skin is no sphere, and slopes that the map reads there belong to one surface (∂p/∂row =
# ∂q/∂column) only when both are taken over the right distances. With pixels that are `a` times as high as wide, the map
# reads p and q / a, so that ∂p/∂row = a² ∂q/∂column.

RING: Final = (1.1, 1.8)
"""Inner and outer radius of the skin that is looked at, in contacts."""

REDUCED_PX: Final = 24.0
"""Radius of a ball in the frame that is looked at; a larger one is reduced to it."""

BLUR: Final = 0.06
"""Standard deviation of the blur of slopes, in radii of the ball."""

LEAST_AGREEMENT: Final = 0.3
"""Correlation of the two derivatives from which on a ball's skin shows the shape."""

LEAST_BALLS: Final = 4
SYSTEMATIC: Final = 0.02
"""Standard uncertainty that does not average out: light that the map misreads is 1.2 % on the one real sensor whose
pixels are known to be square (oem-bga)."""

OF_DEVIATION: Final = 0.1
"""And this share of the deviation: a map that was fitted to stretched balls reads the skin around them a little
wrong (rendered frames: 1.197 of true 1.176, 1.092 of 1.087)."""

OF_DISAGREEMENT: Final = 0.7
"""And this part of how far the two derivatives disagree, (1 - ρ) / (1 + ρ) of their correlation ρ: in cast shadows and
under a wide lens the map is wrong on one side of a ball. Chosen on two public sensors with round contacts, bnz-ur5
(0.90) and fots-gelsight (0.75). Of seven others only cmu-mini is contradicted, by labels that are up to a radius off
(0.147, with 0.139 allowed); with found balls it is not (0.058, with 0.122)."""

SPREAD_OF_QUARTILES: Final = 1.349
COVERAGE: Final = 2.0
MAX_OFF: Final = 0.05
"""Pixels further from the stated shape than this make heights wrong by as much: the calibration does not pass."""


@dataclass(frozen=True, slots=True)
class PixelShape:
    """Height of a pixel over its width, over what is stated, with its standard uncertainty.

    balls : number of balls that show it
    """

    ratio: float
    sigma: float
    balls: int

    @property
    def off(self) -> float:
        """Distance from the shape that is stated."""
        return abs(self.ratio - 1.0)

    @property
    def allowed(self) -> float:
        """The distance that contradicts nothing."""
        return max(COVERAGE * self.sigma, MAX_OFF)

    @property
    def against_stated(self) -> str:
        """The sentence on pixels whose shape was stated and seems another."""
        return (
            f"by the skin around {self.balls} balls the height of pixels over their width is {self.ratio:.3f} ± "
            f"{self.sigma:.3f} of the stated two pitches: shadows or the lens may cause that; else heights are wrong "
            "by as much"
        )

    def disagreement(self, pitch_um: float) -> str:
        """Return the sentence on how pixels differ from the stated ones or may differ; empty where they agree."""
        if self.off <= min(self.sigma, MAX_OFF):
            return ""
        if self.off <= self.allowed:
            return (
                f"the shape of pixels is not confirmed: by the skin around {self.balls} balls their height over width "
                f"is {self.ratio:.2f} ± {COVERAGE * self.sigma:.2f} of the stated, which shadows or the lens may "
                "cause: compare a ruler along both sides of a frame"
            )
        square, found = f"{pitch_um:.4g}", f"{pitch_um * self.ratio:.4g}"
        return (
            f"pixels are not of the stated shape: by the skin around {self.balls} balls the pitch down a column is "
            f"{self.ratio:.3f} ± {self.sigma:.3f} times that along a row (a stream that was resized or "
            f"cropped), and heights are wrong by as much: state two pitches where one was, such as "
            f"pixel_pitch_um = [{square}, {found}], or [{square}, {square}] if you know the pixels to be square"
        )


def measure_pixel_shape(presses: Sequence[UsedPress], inverse_map: InverseMap) -> PixelShape | None:
    """Return the shape that the presses show; None where too few balls do."""
    found = [_shape(press.intensity, ball, inverse_map) for press in presses for ball in press.balls]
    shapes = np.array([one for one in found if one is not None])
    if len(shapes) < LEAST_BALLS:
        return None
    low, ratio, high = np.percentile(shapes[:, 0], [25, 50, 75])
    agreement = float(np.median(shapes[:, 1]))
    scatter = (high - low) / SPREAD_OF_QUARTILES / np.sqrt(len(shapes))
    disagreement = OF_DISAGREEMENT * (1.0 - agreement) / (1.0 + agreement)
    sigma = np.linalg.norm([scatter, SYSTEMATIC, OF_DEVIATION * (ratio - 1.0), disagreement])
    return PixelShape(float(ratio), float(sigma), len(shapes))


def _shape(image: NormalizedImage, ball: Ball, inverse_map: InverseMap) -> tuple[float, float] | None:
    """Return the shape by one ball's skin, by total least squares of the two derivatives, and their correlation.

    None where they do not agree.
    """
    rows, columns = image.shape
    reach = RING[1] * ball.contact_radius_px + 2.0 * BLUR * ball.radius_px + 2.0
    top, bottom = max(int(ball.row - reach), 0), min(int(ball.row + reach) + 2, rows)
    left, right = max(int(ball.column - reach), 0), min(int(ball.column + reach) + 2, columns)
    window = np.s_[top:bottom, left:right]
    factor = max(ball.radius_px / REDUCED_PX, 1.0)
    size = (max(round((right - left) / factor), 3), max(round((bottom - top) / factor), 3))
    values = cv2.resize(np.nan_to_num(image.values[window]), size, interpolation=cv2.INTER_AREA)
    lit = cv2.resize(image.faithful_at(window).astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.99
    scale = ((right - left) / size[0], (bottom - top) / size[1])
    column = ((np.arange(size[0]) + 0.5) * scale[0] - 0.5 + left).astype(np.float32)
    row = ((np.arange(size[1]) + 0.5) * scale[1] - 0.5 + top).astype(np.float32)
    column, row = np.broadcast_arrays(column, row[:, None])
    read = inverse_map.predict(
        np.asarray(values, np.float32).reshape(-1, values.shape[-1]),
        np.asarray(column.ravel(), np.float32),
        np.asarray(row.ravel(), np.float32),
    )
    slopes = read.astype(np.float64).reshape(*row.shape, 2)
    smooth = cv2.GaussianBlur(slopes, (0, 0), max(BLUR * ball.radius_px / factor, 1.0))
    down = np.gradient(smooth[..., 0], axis=0) / scale[1]
    across = np.gradient(smooth[..., 1], axis=1) / scale[0]
    apart = np.hypot(row - ball.row, column - ball.column) / ball.contact_radius_px
    ring = (apart > RING[0]) & (apart < RING[1]) & lit
    if ring.sum() < REDUCED_PX:
        return None
    x, y = across[ring], down[ring]
    xx, yy, both = float((x * x).mean()), float((y * y).mean()), float((x * y).mean())
    agreement = both / max(float(np.sqrt(xx * yy)), 1e-12)
    if agreement <= LEAST_AGREEMENT:
        return None
    square = (yy - xx + np.hypot(yy - xx, 2.0 * both)) / (2.0 * both)
    return float(np.sqrt(square)), agreement
