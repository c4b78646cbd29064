"""What the coach says of one live frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Advice = Literal[
    "calibrate", "too dark", "too bright", "press", "press more", "too deep", "press flatter", "hold still", "ready"
]


@dataclass(frozen=True, slots=True)
class CoachReading:
    """One live frame's figures; None is "not measurable now", never 0.

    contact_share : share of the field where the skin is shaded or raised
    tilt_deg, tilt_towards : how far the contact's plane leans, and the side that is pressed deeper
    motion : change since the frame before, in intensity
    still_s : for how long the contact has not moved
    clipped_share : share of saturated pixels
    exposure : 99th percentile of the frame, share of full scale
    depth_um, depth_share : how far the skin is pushed up, and as a share of the deepest that the slab bears
    in_air : nothing touches the skin
    advice : what to do, as one word for programs
    sentence : the same for people
    cpu_ms : what this reading cost
    """

    contact_share: float | None
    tilt_deg: float | None
    tilt_towards: str
    motion: float | None
    still_s: float
    clipped_share: float
    exposure: float
    depth_um: float | None
    depth_share: float | None
    in_air: bool
    advice: Advice
    sentence: str
    cpu_ms: float
