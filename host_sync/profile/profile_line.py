"""Heights along a chosen line, averaged across it where a width is given."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from device.surface import Float32Array, Float64Array, MaskArray
from host_sync.errors import MeasurementError

MIN_SAMPLES = 8
MIN_WEIGHT = 1e-9


@dataclass(frozen=True, slots=True)
class Line:
    """A line on the field, µm from the centre of the first pixel.

    start_um, end_um : (column, row) of both ends
    width_um : width across the line over which the profile is averaged; 0 takes the line alone
    """

    start_um: tuple[float, float]
    end_um: tuple[float, float]
    width_um: float = 0.0

    @property
    def length_um(self) -> float:
        """Length from end to end, µm."""
        return math.dist(self.start_um, self.end_um)


@dataclass(frozen=True, slots=True, eq=False)
class Profile:
    """Heights at equal steps along a line.

    z_um : float64 array of shape (N,), µm, NaN where invalid
    step_um : sample spacing, µm
    """

    z_um: Float64Array
    step_um: float

    @property
    def along_um(self) -> Float64Array:
        """Distances of the samples from the start: float64 array of shape (N,), µm."""
        return np.arange(self.z_um.size, dtype=np.float64) * self.step_um

    @property
    def masked_share(self) -> float:
        """Fraction of samples without a height."""
        return float(np.isnan(self.z_um).mean())


def profile_along(z_um: Float32Array, pitch_um: float, line: Line) -> Profile:
    """Return the profile along a line: bilinear, one sample per pixel, NaN where one of the four neighbours is invalid.

    Across the line the valid samples are averaged, on the line itself; the profile is invalid where fewer than half of
    them are valid.

    Raises
    ------
    MeasurementError
        The line leaves the field or is too short.
    """
    steps = int(np.floor(line.length_um / pitch_um + 1e-6))
    if steps + 1 < MIN_SAMPLES:
        raise MeasurementError(
            f"the line is {line.length_um:g} µm long, which is less than {MIN_SAMPLES} pixels of {pitch_um:g} µm: "
            "move its ends apart"
        )
    start, end = (np.array(place) / pitch_um for place in (line.start_um, line.end_um))
    limit = np.array(z_um.shape[::-1]) - 1.0
    for name, place in (("start", start), ("end", end)):
        if (place < -0.5).any() or (place > limit + 0.5).any():
            column, row = place * pitch_um
            raise MeasurementError(
                f"the line's {name} ({column:g}, {row:g}) µm lies outside the field of "
                f"{limit[0] * pitch_um:.0f} x {limit[1] * pitch_um:.0f} µm: move it inside"
            )
    along = (end - start) / np.hypot(*(end - start))
    across = np.array([-along[1], along[0]])
    half = line.width_um / pitch_um / 2.0
    offsets = np.linspace(-half, half, max(int(np.ceil(2.0 * half)) + 1, 1)) if half > 0.0 else np.zeros(1)
    places = start + np.arange(steps + 1)[:, None, None] * along + offsets[:, None] * across
    values, seen = bilinear(z_um, places, limit)
    count = seen.sum(axis=-1)
    return Profile(np.where(2 * count >= offsets.size, _means_on_line(values, seen, offsets), np.nan), pitch_um)


def _means_on_line(values: Float64Array, seen: MaskArray, offsets: Float64Array) -> Float64Array:
    """Return mean heights across a line, float64 array of shape (N,).

    Where one side is masked, the mean of the other is extrapolated to the line by the mean slope across the whole line.

    values, seen : arrays of shape (N, M)
    offsets : from the line, their mean is zero: float64 array of shape (M,)
    """
    count = np.maximum(seen.sum(axis=-1), 1)
    mean, middle = (np.where(seen, part, 0.0).sum(axis=-1) / count for part in (values, offsets))
    rise, away = (np.where(seen, part - own[:, None], 0.0) for part, own in ((values, mean), (offsets, middle)))
    slope = (rise * away).sum() / max(float((away * away).sum()), 1e-12)
    return np.asarray(mean - slope * middle, np.float64)


def bilinear(
    z_um: Float32Array, places: Float64Array, limit: Float64Array | None = None
) -> tuple[Float64Array, MaskArray]:
    """Return heights between pixels, and where they are valid: float64 and bool arrays of shape (...).

    places : float64 array of shape (..., 2), column and row in pixels
    limit : largest column and row; that of the array by default
    """
    limit = np.array(z_um.shape[::-1]) - 1.0 if limit is None else limit
    inside = ((places > -0.5) & (places < limit + 0.5)).all(axis=-1)
    places = np.clip(places, 0.0, limit)
    low = np.minimum(np.floor(places), np.maximum(limit - 1.0, 0.0)).astype(np.intp)
    across, down = np.moveaxis(places - low, -1, 0)
    column, row = np.moveaxis(low, -1, 0)
    values = np.zeros(places.shape[:-1])
    for i, weight_down in ((0, 1.0 - down), (1, down)):
        for j, weight_across in ((0, 1.0 - across), (1, across)):
            weight = weight_down * weight_across
            # A pixel without weight may be invalid.
            near = z_um[np.minimum(row + i, z_um.shape[0] - 1), np.minimum(column + j, z_um.shape[1] - 1)]
            values += np.where(weight > MIN_WEIGHT, weight * near, 0.0)
    return values, inside & np.isfinite(values)


# Profile parameters of ISO 21920-2 over the valid samples of a profile.
#
# Ra, Rq, Rsk, Rku, Rt, Rdq, RSm refer to the evaluation length; Rp, Rv, Rz are means over its section lengths. Without
# an L-filter the letter is P instead of R: Pa, Pq, … (with one section by the standard).

HEIGHT_DISCRIMINATION: Final = 0.1
"""Smallest height of a hill or dale that separates elements, as a fraction of Rz."""

MIN_SPACING: Final = 0.01
"""Smallest width of a hill or dale that separates elements, as a fraction of the section length."""


def profile_parameters(profile: Profile, sections: int = 1, kind: str = "P") -> dict[str, float]:
    """Return parameters by name: heights in µm, RSm in µm, Rdq in µm/µm, Rsk and Rku without unit; NaN where undefined.

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
    """Return the mean width of the profile elements, samples; NaN without a complete one.

    An element is a hill and the dale after it. It begins where the profile crosses its mean line upwards between a
    significant dale and a significant hill. Elements with an invalid sample are ignored.
    """
    turns = _crossings(heights, HEIGHT_DISCRIMINATION * rz, MIN_SPACING * section_samples)
    widths = np.diff(turns)
    starts, ends = np.floor(turns[:-1]).astype(int), np.ceil(turns[1:]).astype(int)
    invalid = np.concatenate([[0], np.cumsum(np.isnan(heights))])
    whole = [invalid[min(end + 1, heights.size)] == invalid[start] for start, end in zip(starts, ends, strict=True)]
    widths = widths[np.array(whole, np.bool_)] if widths.size else widths
    return float(widths.mean()) if widths.size else float("nan")


def _crossings(heights: Float64Array, least_height: float, least_width: float) -> Float64Array:
    """Return positions (samples) of upward crossings from a significant dale to a significant hill: float64 array."""
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
    """Return runs [start, end) on one side of the mean line, without holes."""
    side = np.where(np.isnan(heights), 0, np.where(heights > 0.0, 1, -1))
    edges = np.concatenate([[0], np.flatnonzero(np.diff(side)) + 1, [side.size]])
    return [(int(start), int(end)) for start, end in pairwise(edges) if side[start]]


def _zero_before(heights: Float64Array, start: int) -> float:
    """Return the position of the zero crossing before a sample."""
    if start == 0 or np.isnan(heights[start - 1]):
        return float(start)
    before, after = heights[start - 1], heights[start]
    return start - float(after / (after - before))
