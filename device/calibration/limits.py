"""Thresholds that a calibration must reach to be used, and those of its report, all in one place.

Only `flat_field.MAX_DISAGREEMENT` stands elsewhere, because the ball search uses it too.
"""

from __future__ import annotations

from typing import Final

MIN_BALLS: Final = 4
"""With fewer balls no error can be held out that means anything."""

WORST_HELD_OUT_DEG: Final = 8.0
"""A calibration whose held-out balls are worse is refused."""

MAX_RADIUS_SPREAD: Final = 0.08
"""Standard deviation, over balls, of the radius that shading gives over the one stated; more is a disagreement.
A set of few balls is refused from a larger one on (`radii.check_radii`)."""

MAX_CLIPPED: Final = 0.3
"""A ball with a larger share of its contact saturated is not used for training."""

REFERENCE_CLIPPED: Final = 0.1
"""A reference with a larger share saturated cannot be divided by."""

CLEAR_DISAGREEMENT: Final = 0.12
"""Less than `flat_field.MAX_DISAGREEMENT` is two sets of lights too where every frame has another that is twice as
near."""

PITCH_GROSS_SHARE: Final = 0.05
"""A stated pixel pitch that a ball grid contradicts by more is refused; less is reported, the measured one used."""

PITCH_COVERAGE: Final = 2.0
"""A stated pitch this many standard uncertainties off is contradicted."""

PASSED_HELD_OUT_DEG: Final = 5.0
PASSED_STEEPEST_DEG: Final = 25.0
PASSED_SECTORS: Final = 5
PASSED_REJECTED_SHARE: Final = 0.35
"""Report: a calibration passes up to this held-out error, from this covered slope and number of sectors (of nine) on,
and up to this share of rejected balls."""

PASSED_RESTING: Final = 0.8
"""Least fraction of the reference, given as a scan, that reads as skin at rest."""
