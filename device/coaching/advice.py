"""From figures to one piece of advice: the first thing that would spoil a scan, or that all is ready."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from device.coaching.coach_reading import Advice, CoachReading
from device.health_limits import (
    CLIPPED_RETAKE,
    DEEP_SHARE,
    DEEPEST_SHARE,
    LEAST_CONTACT,
    STILL_S,
    TILTED_DEG,
    UNDEREXPOSED,
)


def advise(reading: CoachReading, cpu_ms: float) -> CoachReading:
    """The reading with its advice and what it cost (ms)."""
    advice, sentence = next(_advices(reading))
    return replace(reading, advice=advice, sentence=sentence, cpu_ms=cpu_ms)


def _advices(reading: CoachReading) -> Iterator[tuple[Advice, str]]:
    """Whatever applies, the most urgent first."""
    if reading.exposure < UNDEREXPOSED:
        yield "too dark", "Too dark: check the lights and the lens."
    if reading.clipped_share > CLIPPED_RETAKE:
        yield "too bright", f"Too bright: {reading.clipped_share:.0%} is saturated. Press more evenly or balance anew."
    if reading.contact_share is None:
        yield "calibrate", "No reference yet: calibrate, then the coach can see a contact."
        return
    if reading.contact_share < LEAST_CONTACT:
        yield "press", "Press the object into the gel."
    if reading.depth_share is not None and reading.depth_share > DEEP_SHARE / DEEPEST_SHARE:
        yield "too deep", f"Too deep: {reading.depth_share:.0%} of what the gel bears. Press less."
    if reading.tilt_deg is not None and reading.tilt_deg > TILTED_DEG:
        yield "press flatter", f"Tilted by {reading.tilt_deg:.0f} degrees: press less at the {reading.tilt_towards}."
    if reading.still_s < STILL_S:
        yield "hold still", "Hold still."
    yield "ready", "Ready: push the button."
