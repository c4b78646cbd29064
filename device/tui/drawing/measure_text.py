"""Two points of a quick look against each other, in words."""

from __future__ import annotations

from typing import Final

import numpy as np

from device.quick_look.measures import (
    Point,
    Roughness,
    areal_roughness,
    difference,
    levelled,
    line_between,
    line_roughness,
)
from device.surface.fields import HeightMap

COVERAGE: Final = 2.0
"""Factor of the stated ± over the standard uncertainty, as in the workstation's outputs."""


def measure_text(height: HeightMap, first: Point, second: Point, flatness_um: float | None) -> str:
    """Height difference, distance and angle with ±, roughness of the line and of the box between two points."""
    found = difference(height, first, second, flatness_um)
    has_heights = bool(np.isfinite(found.dz_um))
    dz = f"dz {found.dz_um:.1f}{_pm(found.dz_sigma_um, 1)} µm" if has_heights else "dz unknown: no height at a point"
    parts = [
        dz,
        f"distance {found.distance_um / 1e3:.3f}{_pm(found.distance_sigma_um / 1e3, 3)} mm",
        f"angle {found.angle_deg:.2f}{_pm(found.angle_sigma_deg, 2)}°" if has_heights else "",
        _roughness("R", line_roughness(line_between(height, first, second), height.pitch_um, flatness_um)),
        _roughness("S", areal_roughness(levelled(box_between(height, first, second)), flatness_um)),
    ]
    unknown = " · ± of heights: zero check first" if has_heights and found.dz_sigma_um is None else ""
    return f"{' · '.join(part for part in parts if part)}{unknown}"


def box_between(height: HeightMap, first: Point, second: Point) -> np.ndarray:
    """The heights of the box with these corners, both included: float32 array of shape (h, w)."""
    top, bottom = sorted((round(first[0]), round(second[0])))
    left, right = sorted((round(first[1]), round(second[1])))
    return height.z_um[top : bottom + 1, left : right + 1]


def _pm(sigma: float | None, decimals: int) -> str:
    return "" if sigma is None or not np.isfinite(sigma) else f" ± {COVERAGE * sigma:.{decimals}f}"


def _roughness(letter: str, found: Roughness) -> str:
    """ "Ra 1.20 ± 0.10 Rz 5.3 ± 0.8 µm (cut-off 0.8 mm)", P instead of R without one; empty where nothing is there."""
    if not np.isfinite(found.mean_um) or not found.total_um:
        return "" if found.cutoff_um is None else "Ra, Rz not stated: the line shows form and no roughness"
    kind = "P" if letter == "R" and found.cutoff_um is None else letter
    cutoff = "" if found.cutoff_um is None else f" (cut-off {found.cutoff_um / 1e3:g} mm)"
    mean, total = (_pm(found.mean_sigma_um, 2), _pm(found.total_sigma_um, 1))
    return f"{kind}a {found.mean_um:.2f}{mean} {kind}z {found.total_um:.1f}{total} µm{cutoff}"
