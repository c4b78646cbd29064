"""A placement as what the hand is to do: "Move 8.0 mm left and 2.1 mm up, then turn 10° clockwise."."""

from __future__ import annotations

from typing import Final

from device.guidance.placement import Placement, Target, Unplaced
from device.imaging.flat_field import bin_bayer
from device.quick_look.solver import QuickLookModel, quick_look
from hal.frame import RawFrame

SPOT_MM: Final = 0.3
SPOT_DEG: Final = 1.5
"""Within both, the instrument is on the spot: what remains, the workstation registers."""


def placed(touch: RawFrame, model: QuickLookModel, target: Target) -> Placement | Unplaced:
    """Return where a touch lies against an earlier press. Errors as for `quick_look`."""
    return target.place(quick_look(bin_bayer(touch, model.binning), model).height)


def on_the_spot(found: Placement | Unplaced) -> bool:
    """Return whether the instrument is known to stand where the earlier press was made."""
    return isinstance(found, Placement) and found.distance_mm <= SPOT_MM and abs(found.clockwise_deg) <= SPOT_DEG


def way_back(found: Placement | Unplaced) -> tuple[float, float, float] | None:
    """Return the way as mm right, mm down and degrees clockwise; None where the place is unknown."""
    return None if isinstance(found, Unplaced) else (found.right_mm, found.down_mm, found.clockwise_deg)


def sentence(found: Placement | Unplaced) -> str:
    """Return what to do, for people."""
    if isinstance(found, Unplaced):
        return f"Place unknown: {found.reason}."
    shift = f"±{2.0 * found.shift_sigma_mm:.1f} mm, ±{2.0 * found.turn_sigma_deg:.0f}°"
    if on_the_spot(found):
        return f"On the spot ({shift})."
    ways = way_words(found.right_mm, found.down_mm, 2.0 * found.shift_sigma_mm)
    steps = [f"move {ways}"] if ways else []
    if abs(found.clockwise_deg) > 2.0 * found.turn_sigma_deg:
        turn = "clockwise" if found.clockwise_deg > 0.0 else "anticlockwise"
        steps.append(f"turn {abs(found.clockwise_deg):.0f}° {turn}")
    text = ", then ".join(steps)
    return f"{text[0].upper()}{text[1:]} ({shift})."


def way_words(right_mm: float, down_mm: float, least_mm: float) -> str:
    """A way in words, "8.0 mm left and 2.1 mm up", without parts shorter than `least_mm`."""
    return " and ".join(
        f"{abs(length):.1f} mm {positive if length > 0.0 else negative}"
        for length, positive, negative in ((right_mm, "right", "left"), (down_mm, "down", "up"))
        if abs(length) >= least_mm
    )
