"""The press guide's reading of a live frame, and the one advice that follows from it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

from device.quality.thresholds import (
    CLIPPED_RETAKE,
    DEEP,
    MAX_DEPTH,
    MAX_TILT_DEG,
    MIN_CONTACT,
    STILL_S,
    UNDEREXPOSED,
)

Advice = Literal[
    "calibrate", "too dark", "too bright", "press", "press more", "too deep", "press flatter", "hold still", "ready"
]


@dataclass(frozen=True, slots=True)
class GuideReading:
    """Figures of one live frame; None means not measurable now, never 0.

    contact_fraction : fraction of the field where the skin is shaded or raised
    tilt_deg, tilt_towards : tilt of the contact plane, and the side that is pressed deeper
    motion : change since the previous frame, in intensity
    still_s : how long the contact has not moved
    clipped_fraction : fraction of saturated pixels
    exposure : 99th percentile of the frame, fraction of full scale
    depth_um, depth_fraction : how far the skin is raised, and the same as a fraction of the slab's maximum
    in_air : nothing touches the skin
    advice : what to do, as one word for programs
    sentence : the same for people
    cpu_ms : CPU time of this reading
    """

    contact_fraction: float | None
    tilt_deg: float | None
    tilt_towards: str
    motion: float | None
    still_s: float
    clipped_fraction: float
    exposure: float
    depth_um: float | None
    depth_fraction: float | None
    in_air: bool
    advice: Advice
    sentence: str
    cpu_ms: float


def advise(reading: GuideReading, cpu_ms: float) -> GuideReading:
    """The reading with its advice and its CPU time (ms) filled in."""
    advice, sentence = next(_advices(reading))
    return replace(reading, advice=advice, sentence=sentence, cpu_ms=cpu_ms)


def _advices(reading: GuideReading) -> Iterator[tuple[Advice, str]]:
    """Every advice that applies, most urgent first."""
    if reading.exposure < UNDEREXPOSED:
        yield "too dark", "Too dark: check the lights and the lens."
    if reading.clipped_fraction > CLIPPED_RETAKE:
        clipped = f"{reading.clipped_fraction:.0%}"
        yield "too bright", f"Too bright: {clipped} is saturated. Press more evenly or set the exposure again."
    if reading.contact_fraction is None:
        yield "calibrate", "No reference yet: calibrate first, then contact is shown."
        return
    if reading.contact_fraction < MIN_CONTACT:
        yield "press", "Press the object into the gel."
    if reading.depth_fraction is not None and reading.depth_fraction > DEEP / MAX_DEPTH:
        yield "too deep", f"Too deep: {reading.depth_fraction:.0%} of the gel's limit. Press less."
    if reading.tilt_deg is not None and reading.tilt_deg > MAX_TILT_DEG:
        yield "press flatter", f"Tilted by {reading.tilt_deg:.0f} degrees: press less at the {reading.tilt_towards}."
    if reading.still_s < STILL_S:
        yield "hold still", "Hold still."
    yield "ready", "Ready: push the button."
