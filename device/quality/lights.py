"""Light levels at the field's border and the light driver's flags, compared with the calibration.

A press rarely reaches the border, where the skin then matches the reference and intensity is 1. Driver flags are
advisory because they are sometimes wrong: they alone never reject a press that the camera saw well lit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final, Literal

import numpy as np

from device.imaging.exposure import Levels
from device.imaging.flat_field import NormalizedImage
from device.surface.fields import MaskArray

BORDER_FRACTION: Final = 1 / 12
"""Width of the border as a fraction of the field's shorter side."""

OUT_LEVEL: Final = 0.75
"""Below this fraction of its calibrated level a light, or one of its two LEDs, is out: no slope can be trusted."""

WEAK_LEVEL: Final = 0.9
"""Below this fraction slopes are off by degrees."""


def border_levels(intensity: NormalizedImage) -> Levels | None:
    """Median intensity of R, G and B along the border, 1 as calibrated; None if no border pixel is valid."""
    border = _border(intensity.shape) & intensity.valid
    if not border.any():
        return None
    red, green, blue = (float(level) for level in np.median(intensity.values[border], axis=0))
    return red, green, blue


def light_complaint(
    levels: Levels | None, names: Sequence[str], flags: Mapping[str, str]
) -> tuple[Literal["doubtful", "retake"], str] | None:
    """Return what is wrong with the lights, as a verdict's level and reason; None if nothing is.

    levels : from `border_levels`; None if not measured
    names : of the lights in R, G, B order
    flags : the driver's flags by light, such as "open"
    """
    measured: dict[str, float] = {} if levels is None else dict(zip(names, levels, strict=True))
    out = [name for name in names if (measured[name] < OUT_LEVEL if measured else name in flags)]
    if out:
        found = "; ".join(_describe(name, measured.get(name), flags.get(name)) for name in out)
        return "retake", f"{found}: check its LEDs and wires, and run `retroscan selftest`"
    suspect = [name for name in names if name in flags or measured.get(name, 1.0) < WEAK_LEVEL]
    if suspect:
        found = "; ".join(_describe(name, measured[name], flags.get(name)) for name in suspect)
        return "doubtful", f"{found}: run `retroscan selftest`" + ("" if flags else ", then calibrate again")
    return None


def _describe(name: str, level: float | None, flag: str | None) -> str:
    seen = "" if level is None else f" is at {level:.0%} of its calibrated level"
    return f"light {name}{seen}" + (f"{' and' if seen else ':'} the driver reports {flag}" if flag else "")


def _border(shape: tuple[int, int]) -> MaskArray:
    """True along the border of a field of shape (H, W)."""
    width = max(round(BORDER_FRACTION * min(shape)), 1)
    border = np.ones(shape, np.bool_)
    border[width:-width, width:-width] = False
    return border
