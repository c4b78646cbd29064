"""The press guide's reading of a live frame, and the one advice that follows from it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from device.quality.press_faults import FaultKind, PressFigures, press_faults
from device.quality.thresholds import STILL_S

Advice = FaultKind | Literal["calibrate", "hold still", "ready"]


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


def advise(figures: PressFigures, still_s: float) -> tuple[Advice, str]:
    """Return what to do about a live frame: one word for programs, one sentence for people. It says "ready" of no press
    that the verdict would find at fault for the same figures.
    """
    fault = next(press_faults(figures), None)
    if fault:
        return fault.kind, _sentence(fault.cue or fault.sentence)
    if figures.contact_fraction is None:
        return "calibrate", "No reference yet: calibrate first, then contact is shown."
    if still_s < STILL_S:
        return "hold still", "Hold still."
    return "ready", "Ready: push the button."


def _sentence(text: str) -> str:
    return f"{text[0].upper()}{text[1:]}."
