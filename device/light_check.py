"""Whether every light shines as it did at the calibration: seen at the border of the field, and told by its driver.

A press rarely reaches the border, where the skin then lies as in the reference and intensity reads 1. What the driver
says is advisory: its flags are known to err, so they alone never condemn a press that the camera saw well lit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final, Literal

import numpy as np

from device.exposure_levels import Levels
from device.photometry import IntensityImage
from device.surface import MaskArray

BORDER_SHARE: Final = 1 / 12
"""Width of the border, as a share of the field's shorter side."""

OUT_SHARE: Final = 0.75
"""A light below this share of its calibrated level is out, wholly or one LED of two: no slope can be trusted."""

WEAK_SHARE: Final = 0.9
"""Below this share slopes are off by degrees."""


def border_levels(intensity: IntensityImage) -> Levels | None:
    """Median intensity of R, G and B along the border, 1 as calibrated; None where the reference was dark."""
    border = _border(intensity.shape) & intensity.valid
    if not border.any():
        return None
    red, green, blue = (float(level) for level in np.median(intensity.values[border], axis=0))
    return red, green, blue


def light_complaint(
    levels: Levels | None, names: Sequence[str], flags: Mapping[str, str]
) -> tuple[Literal["doubtful", "retake"], str] | None:
    """What is wrong with the lights, as a verdict's level and reason; None when nothing is.

    levels : of `border_levels`, None when nobody could measure them
    names : of the lights in R, G, B order
    flags : what the driver says, such as "open", by light
    """
    shares: dict[str, float] = {} if levels is None else dict(zip(names, levels, strict=True))
    out = [name for name in names if (shares[name] < OUT_SHARE if shares else name in flags)]
    if out:
        told = "; ".join(_told(name, shares.get(name), flags.get(name)) for name in out)
        return "retake", f"{told}: check its LEDs and wires, and run `retroscan selftest`"
    doubted = [name for name in names if name in flags or shares.get(name, 1.0) < WEAK_SHARE]
    if doubted:
        told = "; ".join(_told(name, shares[name], flags.get(name)) for name in doubted)
        return "doubtful", f"{told}: run `retroscan selftest`" + ("" if flags else ", then calibrate again")
    return None


def _told(name: str, share: float | None, flag: str | None) -> str:
    """One light in words."""
    seen = "" if share is None else f" shines at {share:.0%} of its calibrated level"
    return f"light {name}{seen}" + (f"{' and' if seen else ':'} the driver says {flag}" if flag else "")


def _border(shape: tuple[int, int]) -> MaskArray:
    """True along the border of a field of shape (H, W)."""
    width = max(round(BORDER_SHARE * min(shape)), 1)
    border = np.ones(shape, np.bool_)
    border[width:-width, width:-width] = False
    return border
