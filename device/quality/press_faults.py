"""Faults of a press, in one place: press guide, auto-shutter and verdict agree on the same figures."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from device.bundles.scan import VerdictLevel
from device.quality.thresholds import (
    CLIPPED_RETAKE,
    LIGHT_CONTACT,
    MAX_DEPTH,
    MAX_TILT_DEG,
    MIN_CONTACT,
    MIN_DEPTH,
    UNDEREXPOSED,
)

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
