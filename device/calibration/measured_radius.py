"""Radius of calibration balls as measured: a wrong ball has all its slopes wrong by one factor.

Two measurements share no assumption: the lights' shadows on the ball, which need their positions in the board profile,
and the inverse map of the last calibration of the same gel and lights, if there is one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from device.balls.sphere import Ball, BallSamples
from device.calibration.acceptance import Check
from device.imaging.flat_field import NormalizedImage
from device.inverse_map.model import InverseMap
from device.surface import Float64Array

GENTLE: Final = 0.5
"""Slopes up to which radii are read, as stated."""

MAX_OFF_BY_LAST: Final = 0.08
"""Largest relative difference of a ball's radius from the stated one, as the last calibration reads it."""

MAX_OFF_BY_SHADOW: Final = 0.1
"""The same by the lights' shadows: a light 1.5 mm from its place in the profile, 25 mm away, is worth 7 %."""

MIN_SHADOWS: Final = 4


@dataclass(frozen=True, slots=True)
class MeasuredRadii:
    """Measured radius of the balls over the stated one, medians; None: not measured."""

    stated_mm: float
    by_shadow: float | None
    by_last: float | None

    @property
    def checks(self) -> tuple[Check, ...]:
        """Checks of the balls' radius."""
        found = []
        if self.by_shadow is not None:
            name = "ball radius off from the stated one by the lights' shadows, fraction"
            found.append(Check(name, abs(self.by_shadow - 1.0), MAX_OFF_BY_SHADOW, "at most"))
        if self.by_last is not None:
            name = "ball radius off from the stated one by the last calibration, fraction"
            found.append(Check(name, abs(self.by_last - 1.0), MAX_OFF_BY_LAST, "at most"))
        return tuple(found)

    @property
    def advice(self) -> str:
        """The measured radius and what to do, a sentence and a blank; empty if it agrees with the stated one."""
        if self.by_shadow is not None and abs(self.by_shadow - 1.0) > MAX_OFF_BY_SHADOW:
            return (
                f"By the lights' shadows on it the ball's radius is {self.by_shadow * self.stated_mm:.2f} mm, not "
                f"{self.stated_mm:g} mm: choose the right radius; if it is right, check pixel_pitch_um and the lights' "
                "position_mm in the board profile. "
            )
        if self.by_last is not None and abs(self.by_last - 1.0) > MAX_OFF_BY_LAST:
            return (
                f"By the last calibration the ball's radius is {self.by_last * self.stated_mm:.2f} mm, not "
                f"{self.stated_mm:g} mm: choose the right radius, or give the gel a new name if that one was wrong. "
            )
        return ""


def measure_radii(
    stated_mm: float, shadows_mm: Sequence[float], samples: BallSamples, last: InverseMap | None
) -> MeasuredRadii:
    """Return the balls' radius as stated, by their terminators, and by the last calibration's map.

    shadows_mm : terminators of the balls
    """
    by_last = None
    if last is not None:
        shares = measured_radius_shares(samples, last)
        shares = shares[np.isfinite(shares)]
        by_last = float(np.median(shares)) if shares.size else None
    return MeasuredRadii(stated_mm, _by_shadow(stated_mm, shadows_mm), by_last)


def wrong_by_shadow(stated_mm: float, shadows_mm: Sequence[float]) -> str:
    """Return what is wrong with the balls by their shadows alone; empty if nothing is.

    Shadows show it after a press or two.
    """
    return MeasuredRadii(stated_mm, _by_shadow(stated_mm, shadows_mm), None).advice


def measured_radius_shares(samples: BallSamples, last: InverseMap) -> np.ndarray:
    """Return each ball's measured radius over the stated one, float64 array (number of balls,), NaN without samples.

    last : the inverse map of the last calibration of the same gel and lights. A ball of radius R that is stated as R'
        shows about R' / R times the stated slopes.
    """
    stated = np.stack([samples.p, samples.q], axis=-1).astype(np.float64)
    gentle = np.linalg.norm(stated, axis=1) < GENTLE
    read = np.asarray(last.predict(samples.intensity[gentle], samples.column[gentle], samples.row[gentle]))[:, :2]
    stated, ball = stated[gentle], samples.ball[gentle]
    count = int(samples.ball.max()) + 1
    both = np.bincount(ball, (stated * read).sum(axis=1), count)
    alone = np.bincount(ball, (stated * stated).sum(axis=1), count)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(alone / both)


def _by_shadow(stated_mm: float, shadows_mm: Sequence[float]) -> float | None:
    return float(np.median(shadows_mm)) / stated_mm if len(shadows_mm) >= MIN_SHADOWS else None


# A ball's radius from where each light's own shadow begins on it, without an inverse map: for the first calibration.
#
# On a ball's side away from a light the skin is dark from where the light's rays only graze it. There the skin is
# tilted by the light's elevation φ, so that the terminator is R sin φ away from the ball's centre whatever the skin's
# reflectance. φ follows from the light's position in the board profile, R from the pixel pitch.

WEDGE_RAD: Final = 0.35
RAYS: Final = 9
"""Intensity is averaged over so many rays of a wedge away from the light, on both sides of its middle."""

DISTANCES: Final = np.arange(0.1, 1.0, 0.02)
"""Distances from the ball's centre, shares of its stated radius, at which intensity is read."""

DARK_LENGTH: Final = 0.16
"""Length of the dark part beyond the terminator that is looked at, a share of the stated radius."""

MIN_FALL: Final = 0.3
"""Least fall of intensity from the apex to the terminator; with less it is not certain to be one."""

MAX_REST: Final = 0.025
"""Largest rms deviation of intensity from a fall and a level after it."""

MAX_OF_CONTACT: Final = 1.1
"""A terminator further out than this share of the trusted contact is not on the ball."""


def shadow_radii_mm(
    image: NormalizedImage,
    balls: Sequence[Ball],
    lights_mm: Sequence[tuple[float, float, float]],
    pitch_mm: float,
) -> tuple[float, ...]:
    """Return radii by every terminator seen on balls of one press, mm.

    image, balls : in the same pixels
    lights_mm : position of the light of each channel, as in the board profile
    pitch_mm : pixel pitch of the image
    """
    return tuple(
        radius_mm
        for ball in balls
        for channel, light_mm in enumerate(lights_mm)
        for radius_mm in _readings(image, ball, channel, light_mm, pitch_mm)
    )


def _readings(
    image: NormalizedImage, ball: Ball, channel: int, light_mm: tuple[float, float, float], pitch_mm: float
) -> Iterator[float]:
    """Yield the radius by one light, mm; nothing where its terminator is not seen on the ball."""
    rows, columns = image.shape
    x_mm = pitch_mm * (ball.column - 0.5 * (columns - 1))
    y_mm = pitch_mm * (ball.row - 0.5 * (rows - 1))
    away_x, away_y = x_mm - light_mm[0], y_mm - light_mm[1]
    profile = _profile_away(image, ball, channel, float(np.arctan2(away_y, away_x)))
    share = _terminator(profile)
    if share is None or share * ball.radius_px > MAX_OF_CONTACT * ball.contact_radius_px:
        return
    at_mm = pitch_mm * share * ball.radius_px
    lifted_mm = _height_mm(ball, share * ball.radius_px) * pitch_mm
    distance_mm = float(np.hypot(away_x, away_y)) + at_mm
    yield at_mm / float(np.sin(np.arctan2(light_mm[2] - lifted_mm, distance_mm)))


def _height_mm(ball: Ball, distance_px: float) -> float:
    """Return the height of the skin above the edge of the trusted contact, px; as the sphere of the stated radius."""
    heights = [np.sqrt(max(ball.radius_px**2 - r**2, 0.0)) for r in (distance_px, ball.contact_radius_px)]
    return float(max(heights[0] - heights[1], 0.0))


def _profile_away(image: NormalizedImage, ball: Ball, channel: int, direction_rad: float) -> Float64Array:
    """Return the mean intensity at `DISTANCES` from a ball's centre in a direction.

    NaN where the wedge leaves the image or its pixels are invalid.
    """
    angle = direction_rad + np.linspace(-WEDGE_RAD, WEDGE_RAD, RAYS)
    column = (ball.column + ball.radius_px * DISTANCES[:, None] * np.cos(angle)).astype(np.float32)
    row = (ball.row + ball.radius_px * DISTANCES[:, None] * np.sin(angle)).astype(np.float32)
    values = np.ascontiguousarray(image.values[..., channel])
    read = cv2.remap(values, column, row, cv2.INTER_LINEAR).astype(np.float64)
    whole = cv2.remap(image.valid.astype(np.float32), column, row, cv2.INTER_LINEAR, borderValue=(0.0,))
    weight = (np.asarray(whole) > 0.5).astype(np.float64)
    seen = weight.sum(axis=1)
    mean = (weight * read).sum(axis=1) / np.maximum(seen, 1.0)
    return np.where(seen > 0.5 * RAYS, mean, np.nan)


def _terminator(profile: Float64Array) -> float | None:
    """Return the distance at which a fall ends and a level begins, a share of the radius; None without one."""
    best, found = np.inf, None
    length = round(DARK_LENGTH / float(DISTANCES[1] - DISTANCES[0]))
    for first in range(4, len(DISTANCES) - length):
        part = slice(0, first + length)
        at, values = DISTANCES[part], profile[part]
        if not np.isfinite(values).all():
            break
        end = float(DISTANCES[first])
        bend = np.minimum(at - end, 0.0)
        beyond = np.maximum(at - end, 0.0)
        design = np.stack([np.ones_like(at), bend, bend**2, beyond], axis=-1)
        coefficients, *_ = np.linalg.lstsq(design, values, rcond=None)
        rest = float(np.sqrt(np.mean((design @ coefficients - values) ** 2)))
        falls = coefficients[0] < profile[0] - MIN_FALL and abs(coefficients[3]) < 0.5 * abs(coefficients[1])
        if falls and rest < min(best, MAX_REST):
            best, found = rest, end
    return found
