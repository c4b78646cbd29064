"""Faults of a press, and every threshold of press guide, verdict and health.

Fractions are of the field or of full scale unless stated otherwise; intensity is 1 on untouched skin.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, Literal

from device.bundles.scan import VerdictLevel

CLIPPED_RETAKE: Final = 0.05
CLIPPED_DOUBTFUL: Final = 0.005
"""Maximum fraction of clipped pixels before a press is to be retaken, or is doubtful."""

MIN_CONTACT: Final = 0.005
"""Minimum shaded fraction of the field in a press."""

UNDEREXPOSED: Final = 0.1
"""A frame whose 99th percentile is below this fraction of full scale is mostly noise."""

MAX_DEPTH: Final = 0.5
"""Maximum depth, as the press guide measures it, as a fraction of the slab's thickness. Beyond 0.6 a gel tears or comes
off its window; the guide reads up to a fifth low."""

LIGHT_CONTACT: Final = 0.05
MIN_DEPTH: Final = 0.05
"""A press with a smaller contact fraction and a smaller depth, as a fraction of the slab's thickness, is too light."""

RAISED: Final = 0.03
"""Skin raised by more than this fraction of the slab's thickness is in contact, or close to it."""

MAX_TILT_DEG: Final = 6.0
"""Maximum tilt of the contact plane in a level press."""

TILT_CONTACT: Final = 0.05
"""Minimum contact fraction for a meaningful tilt."""

MOVING: Final = 0.05
"""Change of smoothed intensity between frames, 99th percentile, above which the object moves."""

STILL_S: Final = 0.4
"""Contact that has not moved for this long is still."""

MOTION_DOUBTFUL: Final = 0.10
"""Change between the last live frame and the scan's frame above which the scan may be smeared."""

SHARP: Final = 0.4
"""Fine-to-coarse contrast of the strongest edges below which the frame is far out of focus or smeared."""

LIGHT_DRIFTED: Final = 0.018
"""Relative change of a light since calibration that is reported: 0.02, which costs about half a degree of slope, less
what the measurement may be wrong by."""

DRIFTED: Final = 0.02
"""Relative change of the untouched skin's pattern since calibration that is reported."""

DRIFTED_FAR: Final = 0.10
"""Relative change from which the calibration is useless."""

STALE_EVIDENCE_SCANS: Final = 20
"""After this many scans without untouched skin in view the state of the lights is unknown."""

DEFECT_CONTRAST: Final = 0.04
"""A spot of untouched skin that differs from its surroundings by this fraction is a scratch, dust or a stain."""

MAX_DEFECTS: Final = 0.02
"""Maximum fraction of the field with defects before the gel should be wiped or changed."""

MAX_DARK_SPOTS: Final = 0.002
"""Maximum fraction of a press with dark spots that the calibration's reference does not show."""

GEL_PRESSES: Final = 5000
"""Presses after which a gel's coat should be inspected."""

FLAT_RESIDUAL_UM: Final = 8.0
"""Maximum rms height of untouched skin about its mean plane in a passed zero check."""

OLD_CALIBRATION_S: Final = 30 * 86_400.0
"""Age from which a calibration should be checked with the calibration cap."""

LOW_BATTERY: Final = 0.1
"""Charge below which the battery should be recharged."""


FaultKind = Literal["too dark", "lights", "too bright", "press", "press more", "too deep", "press flatter"]


@dataclass(frozen=True, slots=True)
class PressFault:
    """One fault of a press.

    kind : word for programs
    level : verdict that the fault makes of a scan
    sentence : what to do, for people
    cue : a shorter sentence for the live picture, empty where there is none
    """

    kind: FaultKind
    level: VerdictLevel
    sentence: str
    cue: str = ""


@dataclass(frozen=True, slots=True)
class PressFigures:
    """Figures of a pressed frame; None means not measurable, never 0.

    exposure : 99th percentile of the frame, fraction of full scale
    clipped_fraction : fraction of saturated pixels
    lights : what is wrong with the lights, as level and sentence; None if nothing is known to be
    contact_fraction : fraction of the field where the skin is shaded or raised
    depth_fraction : how far the skin is raised, as a fraction of the slab's thickness
    tilt_deg, tilt_towards : tilt of the contact plane, and the side that is pressed deeper
    """

    exposure: float
    clipped_fraction: float
    lights: tuple[VerdictLevel, str] | None
    contact_fraction: float | None
    depth_fraction: float | None = None
    tilt_deg: float | None = None
    tilt_towards: str = ""

    @property
    def light_is_right(self) -> bool:
        """Return whether contact, depth and tilt mean something: they are read from light."""
        return self.exposure >= UNDEREXPOSED and not self.lights


def press_faults(figures: PressFigures) -> Iterator[PressFault]:
    """Yield every fault of a press, most urgent first. Wrong light makes contact, depth and tilt meaningless."""
    if figures.exposure < UNDEREXPOSED:
        yield PressFault("too dark", "doubtful", "too dark: check the lights and the lens")
        return
    if figures.lights:
        yield PressFault("lights", *figures.lights)
        return
    if figures.clipped_fraction > CLIPPED_RETAKE:
        sentence = f"{figures.clipped_fraction:.0%} of the frame is saturated: press more evenly or lower the exposure"
        yield PressFault("too bright", "retake", sentence)
    if figures.contact_fraction is None:
        return
    if figures.contact_fraction < MIN_CONTACT:
        sentence, cue = "hardly any contact: press harder, or press inside the field", "press the object into the gel"
        yield PressFault("press", "doubtful", sentence, cue)
        return
    depth = figures.depth_fraction
    if depth is not None and depth < MIN_DEPTH and figures.contact_fraction < LIGHT_CONTACT:
        yield PressFault("press more", "doubtful", "too little pressure: press harder")
    if depth is not None and depth > MAX_DEPTH:
        sentence = f"too deep: {depth:.0%} of the gel's thickness, {MAX_DEPTH:.0%} are allowed: press less, it may tear"
        yield PressFault("too deep", "doubtful", sentence)
    if figures.tilt_deg is not None and figures.tilt_deg > MAX_TILT_DEG:
        sentence = f"tilted by {figures.tilt_deg:.0f} degrees: press less at the {figures.tilt_towards}"
        yield PressFault("press flatter", "doubtful", sentence)
