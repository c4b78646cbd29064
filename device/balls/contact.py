"""How far from its apex the skin follows a ball.

The *ramp*, first harmonic of a ring over its distance from the centre, is level near the apex, bends with the
reflectance towards the border of the contact and falls fast where the skin lifts off. One ball alone cannot tell the
bend from the fall, so that its contact is cut early; among the balls of a frame, which share the reflectance, a ball
that falls before the others was pressed less deep.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from device.balls.refinement import SEEN_SHARE, RadialProfiles
from device.surface.fields import Float64Array

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
"""Where a ball's ramp falls under this share of the frame's common ramp, its skin has lifted off."""

MIN_COMPANY: Final = 6
"""Balls of one frame from which a common ramp is drawn."""


def find_contact(rings: RadialProfiles) -> float:
    """Share of the ball's radius inside which the skin follows the sphere, 0 when no ramp is seen."""
    return LIFT_MARGIN * _fall(np.asarray(CONTACT_RINGS), ramp_profile(rings), RAMP_KEPT)


def ramp_profile(rings: RadialProfiles) -> Float64Array:
    """Ramp over the rings in units of its level near the apex, float64 array of shape (K,), NaN where not seen."""
    ramp = np.sqrt((np.abs(rings.first) ** 2).sum(axis=1)) / rings.distance
    ramp[rings.seen < SEEN_SHARE] = np.nan
    near = ramp[(rings.distance <= APEX_RINGS) & np.isfinite(ramp)]
    return ramp / max(float(np.percentile(near, 25)), 1e-9) if near.size else np.full(ramp.shape, np.nan)


def find_contact_radius(profiles: Sequence[Float64Array]) -> Float64Array:
    """Share of the radius at which each ball of a frame leaves the frame's common ramp, shape (number of balls,).

    The common ramp is the upper quartile over the balls; infinite where a ball never leaves it or the balls are few.
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
    """Distance at which the ramp first falls below a level; its last seen ring when it never does."""
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
