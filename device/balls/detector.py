"""The calibration balls of a press, found without help.

Candidates come from ramps in two directions, centres and contacts from rings (`refinement`); what
cannot be used for training is returned with the reason, so that the person who pressed knows what to change.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from device.balls.refinement import (
    SEEN_FRACTION,
    RadialProfiles,
    find_apex,
    find_candidates,
    find_circle,
    join_centres,
    reduce_intensity,
    sample_radial_profiles,
)
from device.balls.sphere import Ball
from device.errors import CalibrationError
from device.imaging.flat_field import NormalizedImage
from device.surface import Float64Array

CANDIDATE_RADIUS_PX: Final = 14.0
REFINE_RADIUS_PX: Final = 28.0
"""A ball's radius in the reduced images in which candidates and centres are sought."""

MAX_CONTACT: Final = 0.8
"""However deep a press, the skin lifts off the sphere near 0.85 of its radius."""

MIN_CONTACT: Final = 0.33
"""A contact under this share of the radius shows slopes of 20 degrees at most, which is too little for training."""

IMPOSSIBLE_CONTACT: Final = 1.08
"""No skin follows a sphere beyond its own radius; the skin around it lets a contact seem a little wider."""

TOO_WIDE: Final = "wider than a ball of this radius can press: check the ball's radius and the pixel pitch"

MIN_RADIUS_PX: Final = 4.0
"""The slopes of a smaller ball change too much from pixel to pixel."""

MIN_CONTACT_ALONE: Final = 0.28
"""A press that shows nothing wider may be fitted from a contact this narrow: up to 16 degrees, at its place."""

SHALLOW: Final = (0.8, 0.64, 0.5, 0.4, 0.32)
"""Fractions of the radius in which a press is searched again that shows no ball: rings and patches of the size of the
radius see little of a contact that is much smaller."""

MIN_SHALLOW: Final = 0.2
"""A contact this narrow shows slopes of 11 degrees; of a narrower one the noise is too large a part."""

PART_OF: Final = 1.5
"""Distance, in radii, up to which a contact is part of a stronger one, for two balls stand a diameter apart; or of
what follows no sphere: an oval dent has an even middle."""

SYMMETRIC: Final = 0.15
"""Share of the shading's energy that may break the rotational symmetry inside the contact."""

MAX_SETTING: Final = 0.5
"""Second harmonic over the first, along its crest, of a light that reaches less than half of a ring."""


@dataclass(frozen=True, slots=True)
class RejectedBall:
    """A place that looks like a ball and cannot be used for training; position in pixels.

    error_deg : mean error of its slopes by a model of the other balls; None where none was evaluated
    """

    column: float
    row: float
    reason: str
    error_deg: float | None = None


@dataclass(frozen=True, slots=True)
class BallSearch:
    """The balls of one press, and what was refused."""

    found: tuple[Ball, ...]
    rejected: tuple[RejectedBall, ...]


def check_radius(radius_px: float, shape: tuple[int, int], name: str) -> None:
    """Refuse a ball that no frame of `shape` (H, W) could show.

    Raises
    ------
    CalibrationError
        Names `name` and the radius.
    """
    if radius_px < MIN_RADIUS_PX:
        raise CalibrationError(
            f"{name}: a ball of radius {radius_px:.3g} px is too small to be seen, {MIN_RADIUS_PX:g} px are needed: "
            "check the ball's radius and the pixel pitch"
        )
    if not fits(radius_px, shape):
        raise CalibrationError(
            f"{name}: no useful contact of a ball of radius {radius_px:.3g} px fits into {shape[1]}x{shape[0]} pixels: "
            "check the ball's radius and the pixel pitch"
        )


def fits(radius_px: float, shape: tuple[int, int]) -> bool:
    """Return True if the smallest contact that is sought fits into a frame of `shape` (H, W)."""
    return 2.0 * MIN_CONTACT * radius_px <= min(shape)


def find_balls(
    image: NormalizedImage,
    radius_px: float,
    expected: Sequence[tuple[float, float]] = (),
    name: str = "the press",
    shallow: Sequence[float] = (),
) -> BallSearch:
    """Return balls of radius `radius_px` in a press, with centre and trusted contact; none is an answer too.

    expected : (column, row) of places to look at, whether a ball is suspected there or not
    name : of the press, for errors
    shallow : fractions of the radius in which a press that shows no ball, or a contact narrower than the rings of its
        apex, is searched again, with another exposure allowed for too; without them it is searched once

    Raises
    ------
    CalibrationError
        No frame of this size could show a ball of that radius.
    """
    check_radius(radius_px, image.shape, name)
    sightings = _look(image, radius_px, expected)
    reasons = [_fault(sighting, image.shape, radius_px) for sighting in sightings]
    if all(reasons) and (alone := _alone(sightings, image.shape, radius_px)) is not None:
        reasons[alone] = ""
    good = [sighting for sighting, reason in zip(sightings, reasons, strict=True) if not reason]
    reasons = [reason or _part_of_another(s, good, radius_px) for s, reason in zip(sightings, reasons, strict=True)]
    kept = [sighting for sighting, reason in zip(sightings, reasons, strict=True) if not reason]
    rejected = [RejectedBall(s.column, s.row, reason) for s, reason in zip(sightings, reasons, strict=True) if reason]
    found = []
    for s, lift_off in zip(kept, find_contact_radius([ramp_profile(s.rings) for s in kept]), strict=True):
        if lift_off < MAX_CONTACT:
            reason = f"contact too small ({lift_off:.2f} of the radius, less than the frame's other balls)"
            rejected.append(RejectedBall(s.column, s.row, reason))
        else:
            found.append(Ball(s.column, s.row, min(s.contact, MAX_CONTACT) * radius_px, radius_px))
    if shallow and (not found or (len(found) == 1 and found[0].contact_radius_px < APEX_RINGS * radius_px)):
        found = _search_again(image, radius_px, sightings, shallow) or found
    return BallSearch(tuple(found), tuple(rejected))


def _search_again(
    image: NormalizedImage, radius_px: float, whole: Sequence[_Sighting], fractions: Sequence[float]
) -> list[Ball]:
    """Return the only ball of a press that the first search missed, else an empty list.

    A contact as narrow as a smaller ball's is sought first, then one whose intensity differs from untouched skin's by
    one factor in all channels: another exposure and a deep press cause that.

    whole : what is seen in rings of the whole radius
    fractions : radii of smaller balls as fractions of the radius, in the order in which they are tried
    """
    uneven = [(sighting, radius_px) for sighting in whole if _unevenness(sighting)]
    for fraction, common_factor in [*((f, False) for f in fractions), *((f, True) for f in (1.0, *fractions))]:
        window_px = fraction * radius_px
        sightings = _look(image, window_px, (), common_factor=common_factor) if window_px >= MIN_RADIUS_PX else []
        uneven += [(sighting, window_px) for sighting in sightings if _unevenness(sighting)]
        alone = _alone(sightings, image.shape, window_px)
        if alone is not None:
            one = sightings[alone]
            contact_px = min(one.contact * fraction, MAX_CONTACT) * radius_px
            part = any(np.hypot(one.column - u.column, one.row - u.row) < PART_OF * size for u, size in uneven)
            too_small = contact_px < MIN_SHALLOW * radius_px
            return [] if part or too_small else [Ball(one.column, one.row, contact_px, radius_px)]
    return []


def _unevenness(sighting: _Sighting) -> float:
    """Return the share of the shading's energy that no sphere shows, 0 where it is small enough for one."""
    uneven, even = _energies(sighting.rings, min(sighting.contact, MAX_CONTACT))
    share = uneven / max(uneven + even, 1e-12)
    return share if share > SYMMETRIC else 0.0


def _part_of_another(one: _Sighting, good: Sequence[_Sighting], radius_px: float) -> str:
    """Return the fault of a sighting that is nearer to a stronger one than two balls can be; empty of others."""

    def strength(sighting: _Sighting) -> float:
        return _energies(sighting.rings, min(sighting.contact, MAX_CONTACT))[1]

    near = [s for s in good if s is not one and np.hypot(s.column - one.column, s.row - one.row) < PART_OF * radius_px]
    return "part of the dent of a ball nearby" if any(strength(s) > strength(one) for s in near) else ""


@dataclass(frozen=True, slots=True, eq=False)
class _Sighting:
    """A refined candidate: position in pixels, contact as a share of the radius, and its rings."""

    column: float
    row: float
    contact: float
    rings: RadialProfiles


def _look(
    image: NormalizedImage, radius_px: float, expected: Sequence[tuple[float, float]], *, common_factor: bool = False
) -> list[_Sighting]:
    """Return every candidate and expected place with its contact and its centre, read with the whole frame's balls."""
    coarse = reduce_intensity(image, radius_px / CANDIDATE_RADIUS_PX)
    fine = reduce_intensity(image, radius_px / REFINE_RADIUS_PX)
    reduced_radius = radius_px / fine.columns_per_pixel
    circles: list[Float64Array] = []
    candidates = find_candidates(coarse, radius_px / coarse.columns_per_pixel, common_factor=common_factor)
    for place in (*candidates, *expected):
        circle = find_circle(fine, *fine.from_full(*place), reduced_radius)
        if not any(np.hypot(*(circle - other)) < reduced_radius for other in circles):
            circles.append(circle)
    apexes = [find_apex(fine, circle, reduced_radius) for circle in circles]
    sightings = []
    for centre in join_centres(fine, np.array(circles), np.array(apexes), reduced_radius):
        rings = sample_radial_profiles(fine, centre, reduced_radius, np.asarray(CONTACT_RINGS))
        column, row = (float(place) for place in fine.to_full(*centre))
        sightings.append(_Sighting(column, row, float(find_contact(rings)), rings))
    return sightings


def _alone(sightings: Sequence[_Sighting], shape: tuple[int, int], radius_px: float) -> int | None:
    """Return the index of the only useful sighting of a press; None where there is none or several.

    The contact may be narrow, or run over the frame's border if it is good where it is seen. It ends at the last ring
    of which enough is seen (`SEEN_FRACTION`).
    """
    useful = [k for k, sighting in enumerate(sightings) if not _fault(sighting, shape, radius_px, alone=True)]
    return useful[0] if len(useful) == 1 else None


def _fault(sighting: _Sighting, shape: tuple[int, int], radius_px: float, *, alone: bool = False) -> str:
    """Return why a ball cannot be used for training; empty when it can.

    alone : whether its press shows no other
    """
    rows, columns = shape
    margin = min(sighting.column + 0.5, sighting.row + 0.5, columns - 0.5 - sighting.column, rows - 0.5 - sighting.row)
    contact = min(sighting.contact, MAX_CONTACT)
    if margin < (0.0 if alone else contact * radius_px):
        return "cut by the frame's border"
    if contact < (MIN_CONTACT_ALONE if alone else MIN_CONTACT):
        return f"contact too small ({contact:.2f} of the radius)"
    if uneven := _unevenness(sighting):
        return f"does not follow the sphere ({uneven:.0%} of its shading is uneven)"
    if sighting.contact > IMPOSSIBLE_CONTACT:
        return TOO_WIDE
    return ""


def _energies(rings: RadialProfiles, contact: float) -> tuple[float, float]:
    """Return the energy of the shading inside the contact that no sphere can show, and of the other.

    A light's image on a sphere is symmetric about its direction. A light that sets on the far side, or that
    shines, adds a second harmonic whose crest lies where the first has its own: 0.42 of it when half the ring is dark.
    That part counts as even.
    """
    inside = (rings.distance <= contact) & (rings.seen > 0.3)
    weight = (rings.distance * rings.seen)[inside, None]
    first, size = rings.first[inside], np.abs(rings.first[inside])
    second = rings.second[inside] * np.conj(first / np.maximum(size, 1e-12)) ** 2
    second = second - np.clip(second.real, 0.0, MAX_SETTING * size)
    uneven = (weight * (2.0 * np.abs(second) ** 2 + rings.rest[inside])).sum()
    return float(uneven), float((weight * 2.0 * size**2).sum())


# Distance from its apex up to which the skin follows a ball.
#
# The *ramp*, first harmonic of a ring over its distance from the centre, is level near the apex, bends with the
# reflectance towards the border of the contact and falls fast where the skin lifts off. One ball alone does not
# separate the bend from the fall, so that its contact is cut early; among the balls of a frame, which share the
# reflectance, a ball that falls before the others was pressed less deep.

CONTACT_RINGS: Final = tuple(0.1 + 0.05 * k for k in range(27))
"""Distances of the rings that show a contact, shares of the ball's radius."""

APEX_RINGS: Final = 0.4
"""The ramp's level is its lower quartile up to this share of the radius: a hair or a grain only adds to it."""

RAMP_KEPT: Final = 0.6
"""Inside the contact the ramp keeps this share of its level near the apex."""

LIFT_MARGIN: Final = 0.8
"""Trusted share of the radius at which the ramp falls below `RAMP_KEPT`: the skin lifts off gradually.

With 0.85 the map of a skin with a narrow lobe is trained on skin that has lifted off (docs/accuracy.md).
"""

LEVEL_RINGS: Final = 0.6
"""A ball's ramp is brought to the level of the common ramp up to this share of the radius."""

COMMON_KEPT: Final = 0.85
"""Share of the frame's common ramp under which a ball's own ramp shows that its skin has lifted off."""

MIN_COMPANY: Final = 6
"""Balls of one frame from which a common ramp is drawn."""


def find_contact(rings: RadialProfiles) -> float:
    """Return the share of the ball's radius inside which the skin follows the sphere, 0 when no ramp is seen."""
    return LIFT_MARGIN * _fall(np.asarray(CONTACT_RINGS), ramp_profile(rings), RAMP_KEPT)


def ramp_profile(rings: RadialProfiles) -> Float64Array:
    """Ramp over the rings in units of its level near the apex, float64 array of shape (K,), NaN where not seen."""
    ramp = np.sqrt((np.abs(rings.first) ** 2).sum(axis=1)) / rings.distance
    ramp[rings.seen < SEEN_FRACTION] = np.nan
    near = ramp[(rings.distance <= APEX_RINGS) & np.isfinite(ramp)]
    return ramp / max(float(np.percentile(near, 25)), 1e-9) if near.size else np.full(ramp.shape, np.nan)


def find_contact_radius(profiles: Sequence[Float64Array]) -> Float64Array:
    """Return the fraction of the radius at which each ball of a frame leaves the frame's common ramp.

    Float64 array of shape (balls,). The common ramp is the upper quartile over the balls; infinite where a ball never
    leaves it or the balls are few.
    """
    if len(profiles) < MIN_COMPANY:
        return np.full(len(profiles), np.inf)
    table = np.stack(profiles)
    distance = np.asarray(CONTACT_RINGS)
    seen = np.isfinite(table).sum(axis=0) >= MIN_COMPANY
    common = np.nanpercentile(table[:, seen], 75, axis=0)
    ratio = table[:, seen] / common
    ratio /= np.nanpercentile(ratio[:, distance[seen] <= LEVEL_RINGS], 25, axis=1, keepdims=True)
    falls = [_fall(distance[seen], row, COMMON_KEPT) for row in ratio]
    return np.array([np.inf if fall >= distance[seen][-1] else fall for fall in falls])


def _fall(distance: Float64Array, ramp: Float64Array, level: float) -> float:
    """Return the distance at which the ramp first falls below a level; its last seen ring when it never does."""
    seen = np.isfinite(ramp)
    distance, ramp = distance[seen], ramp[seen]
    below = np.nonzero((ramp < level) & (distance > APEX_RINGS))[0]
    if not distance.size:
        return 0.0
    if not below.size:
        return float(distance[-1])
    k = int(below[0])
    if k == 0 or ramp[k - 1] < level:
        return float(distance[max(k - 1, 0)])
    share = (ramp[k - 1] - level) / (ramp[k - 1] - ramp[k])
    return float(distance[k - 1] + share * (distance[k] - distance[k - 1]))
