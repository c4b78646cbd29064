"""Profile parameters of ISO 21920-2 over the valid samples of a profile.

Ra, Rq, Rsk, Rku, Rt, Rdq, RSm are taken over the evaluation length; Rp, Rv, Rz are means over its section lengths. A
profile that no L-filter made wears a P instead of the R: Pa, Pq, … (for which the standard has one section).
"""

from __future__ import annotations

from itertools import pairwise
from typing import Final

import numpy as np

from device.surface import Float64Array
from host_sync.measurement.profile_line import Profile

HEIGHT_DISCRIMINATION: Final = 0.1
"""A hill or dale lower than this share of the section's Rz does not part elements."""

LEAST_SPACING: Final = 0.01
"""A hill or dale narrower than this share of a section length does not part elements."""


def profile_parameters(profile: Profile, sections: int = 1, kind: str = "P") -> dict[str, float]:
    """Parameters by name: heights in µm, RSm in µm, Rdq in µm/µm, Rsk and Rku without unit; NaN where undefined.

    profile : with zero at its mean line
    sections : number of section lengths
    kind : the first letter of the names
    """
    heights = profile.z_um - np.nanmean(profile.z_um) if np.isfinite(profile.z_um).any() else profile.z_um
    seen = heights[np.isfinite(heights)]
    if seen.size < 2:
        names = ("a", "q", "sk", "ku", "t", "p", "v", "z", "dq", "Sm")
        return {kind + name: float("nan") for name in names}
    rq = float(np.sqrt((seen**2).mean()))
    parts = [part[np.isfinite(part)] for part in np.array_split(heights, sections)]
    peaks = [float(part.max()) for part in parts if part.size]
    pits = [float(-part.min()) for part in parts if part.size]
    slopes = np.diff(heights) / profile.step_um
    found = {
        "a": float(np.abs(seen).mean()),
        "q": rq,
        "sk": float((seen**3).mean() / rq**3) if rq else float("nan"),
        "ku": float((seen**4).mean() / rq**4) if rq else float("nan"),
        "t": float(seen.max() - seen.min()),
        "p": float(np.mean(peaks)),
        "v": float(np.mean(pits)),
        "z": float(np.mean(peaks) + np.mean(pits)),
        "dq": float(np.sqrt(np.nanmean(slopes**2))) if np.isfinite(slopes).any() else float("nan"),
    }
    section_samples = heights.size / sections
    found["Sm"] = profile.step_um * mean_spacing(heights, found["z"], section_samples)
    return {kind + name: value for name, value in found.items()}


def mean_spacing(heights: Float64Array, rz: float, section_samples: float) -> float:
    """Mean width of the profile's elements (a hill and the dale after it), samples; NaN when there is no whole one.

    Elements begin where the profile rises through its mean line between a dale and a hill that count. One that holds
    an invalid sample is left out.
    """
    turns = _crossings(heights, HEIGHT_DISCRIMINATION * rz, LEAST_SPACING * section_samples)
    widths = np.diff(turns)
    starts, ends = np.floor(turns[:-1]).astype(int), np.ceil(turns[1:]).astype(int)
    invalid = np.concatenate([[0], np.cumsum(np.isnan(heights))])
    whole = [invalid[min(end + 1, heights.size)] == invalid[start] for start, end in zip(starts, ends, strict=True)]
    widths = widths[np.array(whole, np.bool_)] if widths.size else widths
    return float(widths.mean()) if widths.size else float("nan")


def _crossings(heights: Float64Array, least_height: float, least_width: float) -> Float64Array:
    """Places (samples) where the profile rises from a dale that counts to a hill that counts: float64 array."""
    sign = 0  # of the last hill (1) or dale (-1) that counted
    places: list[float] = []
    rise = float("nan")
    for start, end in _runs(heights):
        side = 1 if heights[start] > 0.0 else -1
        counts = np.abs(heights[start:end]).max() >= least_height and end - start >= least_width
        if side == 1 and sign <= 0 and np.isnan(rise):
            rise = _zero_before(heights, start)
        if not counts:
            continue
        if side == 1 and sign == -1:
            places.append(rise)
        if side == -1 or sign == 0:
            rise = float("nan")
        sign = side
    return np.array(places)


def _runs(heights: Float64Array) -> list[tuple[int, int]]:
    """Stretches [start, end) on one side of the mean line, holes left out."""
    side = np.where(np.isnan(heights), 0, np.where(heights > 0.0, 1, -1))
    edges = np.concatenate([[0], np.flatnonzero(np.diff(side)) + 1, [side.size]])
    return [(int(start), int(end)) for start, end in pairwise(edges) if side[start]]


def _zero_before(heights: Float64Array, start: int) -> float:
    """Where the profile crossed zero between a sample and the one before it."""
    if start == 0 or np.isnan(heights[start - 1]):
        return float(start)
    before, after = heights[start - 1], heights[start]
    return start - float(after / (after - before))
