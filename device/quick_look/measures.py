"""Numbers read from a quick look: level, roughness of an area or a line, and two points against each other.

The formulas are those of the workstation (ISO 25178-2, ISO 21920-2, ISO 16610-21 and -31), with numpy only.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from device.surface import Float32Array, Float64Array, HeightMap

CUTOFFS_UM: Final = (250.0, 800.0, 2500.0)

SECTIONS: Final = 5
"""A roughness profile has five cut-off lengths, of the largest cut-off that fits."""

RUN_UP: Final = 0.5
"""Length at each end of a line that the filter distorts and that is not evaluated, in cut-off lengths."""

MIN_CUTOFF_PX: Final = 8.0
"""Pixels of the shortest cut-off: fewer show little of what is shorter than it."""

ROUNDING: Final = 1e-9

MEAN_OF_RMS: Final = float(np.sqrt(2.0 / np.pi))

SPAN_OF_RMS: Final = 6.0
"""Mean absolute value and span of height errors over their standard deviation."""

_ALPHA: Final = float(np.sqrt(np.log(2.0) / np.pi))

_REACH: Final = 4.0

_MIN_DETERMINANT: Final = 1e-6

_LOCAL_PX: Final = 2

_PLANE: Final = 3
"""Parameters of a plane, taken off the number of pixels that it was fitted to."""

Point = tuple[float, float]
"""Row and column, pixels."""


@dataclass(frozen=True, slots=True)
class Roughness:
    """Mean and total height, µm: Sa and Sz of an area, Ra and Rz of a line; `cutoff_um` is None without a filter.

    mean_sigma_um, total_sigma_um : standard uncertainties, from the scatter of a line's five sections and from height
        errors as large as those of untouched skin; None where those were not measured
    """

    mean_um: float
    total_um: float
    cutoff_um: float | None = None
    mean_sigma_um: float | None = None
    total_sigma_um: float | None = None


@dataclass(frozen=True, slots=True)
class Difference:
    """The second point against the first.

    dz_um, distance_um, angle_deg : height, distance in the plane, slope of the line between them; height and slope are
        NaN where a point has no height
    dz_sigma_um, distance_sigma_um, angle_sigma_deg : standard uncertainties from noise, flatness and the pixels; None
        where the flatness of untouched skin was not measured. The calibration's scale is not in them.
    """

    dz_um: float
    distance_um: float
    angle_deg: float
    dz_sigma_um: float | None
    distance_sigma_um: float
    angle_sigma_deg: float | None


def levelled(z_um: Float32Array) -> Float32Array:
    """Return heights above their least-squares plane: float32 array of shape (H, W), NaN where invalid."""
    row, column = np.nonzero(np.isfinite(z_um))
    if row.size < 3:
        return z_um
    design = np.stack([column, row, np.ones(row.size)], axis=-1).astype(np.float64)
    plane, *_ = np.linalg.lstsq(design, z_um[row, column].astype(np.float64), rcond=None)
    down, across = np.mgrid[: z_um.shape[0], : z_um.shape[1]]
    return np.asarray(z_um - (across * plane[0] + down * plane[1] + plane[2]), np.float32)


def areal_roughness(z_um: Float32Array, flatness_um: float | None = None) -> Roughness:
    """Sa and Sz of an area about its mean; level it first.

    flatness_um : rms of untouched skin's heights; None if not measured
    """
    seen = z_um[np.isfinite(z_um)].astype(np.float64)
    if not seen.size:
        return Roughness(float("nan"), float("nan"))
    seen -= seen.mean()
    mean_um, total_um = float(np.abs(seen).mean()), float(seen.max() - seen.min())
    return Roughness(mean_um, total_um, None, *_sigmas([mean_um], [total_um], flatness_um))


def line_between(height: HeightMap, start: Point, end: Point) -> Float64Array:
    """Return heights (µm) along the line between two points, interpolated, a pixel apart: float64 array (N,)."""
    rows, columns = height.z_um.shape
    count = max(round(float(np.hypot(end[0] - start[0], end[1] - start[1]))) + 1, 2)
    row = np.clip(np.linspace(start[0], end[0], count), 0.0, rows - 1.0)
    column = np.clip(np.linspace(start[1], end[1], count), 0.0, columns - 1.0)
    top, left = np.minimum(row.astype(int), rows - 2), np.minimum(column.astype(int), columns - 2)
    down, right = row - top, column - left
    z = height.z_um.astype(np.float64)
    upper = z[top, left] * (1.0 - right) + z[top, left + 1] * right
    lower = z[top + 1, left] * (1.0 - right) + z[top + 1, left + 1] * right
    return np.asarray(upper * (1.0 - down) + lower * down)


def line_roughness(z_um: Float64Array, step_um: float, flatness_um: float | None = None) -> Roughness:
    """Ra and Rz of a levelled line with the largest cut-off that fits; Pa and Pz of the line itself if none does.

    A cut-off fits if the line holds five of it between two run-ups and it holds enough pixels. Ra and Rz are NaN where
    Rz is less than twice Ra: that is form which the filter leaves, and no roughness.

    z_um : heights `step_um` apart
    flatness_um : rms of untouched skin's heights; None if not measured
    """
    seen = np.isfinite(z_um)
    if seen.sum() < 2:
        return Roughness(float("nan"), float("nan"))
    place = np.arange(z_um.size, dtype=np.float64)
    heights = z_um - np.polyval(np.polyfit(place[seen], z_um[seen], 1), place)
    cutoff_um = max((one for one in CUTOFFS_UM if _fits(one, heights.size, step_um)), default=None)
    if cutoff_um is None:
        return _of_profile(heights, 1, None, flatness_um)
    rough = heights - mean_line(heights, cutoff_um / step_um)
    used = round(SECTIONS * cutoff_um / step_um)
    first = (rough.size - used) // 2
    return _of_profile(rough[first : first + used], SECTIONS, cutoff_um, flatness_um)


def _fits(cutoff_um: float, samples: int, step_um: float) -> bool:
    room_um = step_um * (samples - 1)
    return MIN_CUTOFF_PX * step_um <= cutoff_um and (SECTIONS + 2.0 * RUN_UP) * cutoff_um <= room_um


def mean_line(z_um: Float64Array, cutoff_samples: float) -> Float64Array:
    """Return gaussian mean line (ISO 16610-21), of first order at ends and holes (-31): float64 array of shape (N,)."""
    sigma = _ALPHA * cutoff_samples / np.sqrt(2.0 * np.pi)
    reach = max(int(np.ceil(_REACH * sigma)), 1)
    x = np.arange(-reach, reach + 1) / sigma
    weight = np.exp(-0.5 * x * x)
    valid = np.isfinite(z_um)
    if not valid.any():
        return z_um.copy()
    level = float(z_um[valid].mean())
    filled, ones = np.where(valid, z_um - level, 0.0), valid.astype(np.float64)

    def around(values: Float64Array, power: int) -> Float64Array:
        return np.convolve(values, (weight / weight.sum() * x**power)[::-1])[reach : reach + values.size]

    n, first, second = (around(ones, power) for power in range(3))
    z0, z1 = (around(filled, power) for power in range(2))
    n = np.maximum(n, 1e-9)
    determinant = n * second - first * first
    spans = determinant > _MIN_DETERMINANT * n * n
    line = (z0 * second - z1 * first) / np.where(spans, determinant, 1.0)
    return np.where(valid, np.where(spans, line, z0 / n) + level, np.nan)


def difference(height: HeightMap, first: Point, second: Point, flatness_um: float | None) -> Difference:
    """Return the second point against the first.

    flatness_um : rms of untouched skin's heights, as the zero check measures it; None if not measured
    """
    (z0, noise0), (z1, noise1) = _at(height, first), _at(height, second)
    pitch = height.pitch_um
    distance_um = pitch * float(np.hypot(second[0] - first[0], second[1] - first[1]))
    dz_um = z1 - z0
    distance_sigma_um = pitch / float(np.sqrt(6.0))  # two points, each uniform over a pixel
    dz_sigma_um = None if flatness_um is None else float(np.sqrt(2.0 * flatness_um**2 + noise0**2 + noise1**2))
    angle = float(np.degrees(np.arctan2(dz_um, distance_um))) if distance_um else float("nan")
    angle_sigma = None
    if dz_sigma_um is not None and distance_um:
        square = distance_um**2 + dz_um**2
        parts = distance_um * dz_sigma_um, dz_um * distance_sigma_um
        angle_sigma = float(np.degrees(np.hypot(*parts) / square))
    return Difference(dz_um, distance_um, angle, dz_sigma_um, distance_sigma_um, angle_sigma)


def _of_profile(heights: Float64Array, sections: int, cutoff_um: float | None, flatness_um: float | None) -> Roughness:
    heights = heights - np.nanmean(heights) if np.isfinite(heights).any() else heights
    parts = [part[np.isfinite(part)] for part in np.array_split(heights, sections)]
    spans = [float(part.max() - part.min()) for part in parts if part.size]
    if not spans:
        return Roughness(float("nan"), float("nan"), cutoff_um)
    means = [float(np.abs(part).mean()) for part in parts if part.size]
    mean_um, total_um = float(np.nanmean(np.abs(heights))), float(np.mean(spans))
    if total_um < 2.0 * mean_um * (1.0 - ROUNDING):
        return Roughness(float("nan"), float("nan"), cutoff_um)
    return Roughness(mean_um, total_um, cutoff_um, *_sigmas(means, spans, flatness_um))


def _sigmas(means: list[float], spans: list[float], flatness_um: float | None) -> tuple[float | None, float | None]:
    """Return the standard uncertainties of mean and total height, µm; None without a flatness.

    Each combines the scatter of the sections with what height errors alone would show, for errors of long waves may
    agree with the surface.

    means, spans : of each section, µm
    """
    if flatness_um is None:
        return None, None
    found = []
    for sections, share in ((means, MEAN_OF_RMS), (spans, SPAN_OF_RMS)):
        scatter = float(np.std(sections, ddof=1) / np.sqrt(len(sections))) if len(sections) > 1 else 0.0
        found.append(float(np.hypot(scatter, share * flatness_um)))
    return found[0], found[1]


def _at(height: HeightMap, point: Point) -> tuple[float, float]:
    """Return the height of the pixel at a point and its noise, µm; NaN where it is not valid.

    The noise is the standard deviation of the pixels around it about their plane.
    """
    row, column = round(point[0]), round(point[1])
    part = height.z_um[
        max(row - _LOCAL_PX, 0) : row + _LOCAL_PX + 1, max(column - _LOCAL_PX, 0) : column + _LOCAL_PX + 1
    ]
    seen = np.isfinite(part)
    z_um = float(height.z_um[row, column])
    left = int(seen.sum()) - _PLANE
    if not np.isfinite(z_um) or left < 1:
        return z_um, float("nan")
    return z_um, float(np.sqrt(np.nansum(levelled(part).astype(np.float64) ** 2) / left))
