"""Profile parameters of ISO 21920-2 over the valid samples of a profile.

Ra, Rq, Rsk, Rku, Rt, Rdq, RSm refer to the evaluation length; Rp, Rv, Rz are means over its section lengths. Without an
L-filter the letter is P instead of R: Pa, Pq, … (with one section by the standard).
"""

from __future__ import annotations

from itertools import pairwise
from typing import Final

import numpy as np

from device.surface.fields import Float64Array
from host_sync.profile.profile_line import Profile

HEIGHT_DISCRIMINATION: Final = 0.1
"""Smallest height of a hill or dale that separates elements, as a fraction of Rz."""

MIN_SPACING: Final = 0.01
"""Smallest width of a hill or dale that separates elements, as a fraction of the section length."""


def profile_parameters(profile: Profile, sections: int = 1, kind: str = "P") -> dict[str, float]:
    """Parameters by name: heights in µm, RSm in µm, Rdq in µm/µm, Rsk and Rku without unit; NaN where undefined.

    profile : with zero at its mean line
    sections : number of section lengths
    kind : first letter of the names
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
    """Mean width of the profile elements (a hill and the dale after it), samples; NaN without a complete one.

    An element begins where the profile crosses its mean line upwards between a significant dale and a significant hill.
    Elements with an invalid sample are ignored.
    """
    turns = _crossings(heights, HEIGHT_DISCRIMINATION * rz, MIN_SPACING * section_samples)
    widths = np.diff(turns)
    starts, ends = np.floor(turns[:-1]).astype(int), np.ceil(turns[1:]).astype(int)
    invalid = np.concatenate([[0], np.cumsum(np.isnan(heights))])
    whole = [invalid[min(end + 1, heights.size)] == invalid[start] for start, end in zip(starts, ends, strict=True)]
    widths = widths[np.array(whole, np.bool_)] if widths.size else widths
    return float(widths.mean()) if widths.size else float("nan")


def _crossings(heights: Float64Array, least_height: float, least_width: float) -> Float64Array:
    """Positions (samples) of upward crossings from a significant dale to a significant hill: float64 array."""
    sign = 0  # of the last significant hill (1) or dale (-1)
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
    """Runs [start, end) on one side of the mean line, without holes."""
    side = np.where(np.isnan(heights), 0, np.where(heights > 0.0, 1, -1))
    edges = np.concatenate([[0], np.flatnonzero(np.diff(side)) + 1, [side.size]])
    return [(int(start), int(end)) for start, end in pairwise(edges) if side[start]]


def _zero_before(heights: Float64Array, start: int) -> float:
    """Position of the zero crossing before a sample."""
    if start == 0 or np.isnan(heights[start - 1]):
        return float(start)
    before, after = heights[start - 1], heights[start]
    return start - float(after / (after - before))
