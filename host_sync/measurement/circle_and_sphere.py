"""The circle through a round edge of a surface (the rim of a hole, a disc, a dimple), and its least-squares sphere.

Rays from the centre cross the edge; on each, the edge lies where the height crosses half way between what is inside and
what is outside. The circle is fitted to these places by least squares with Tukey weights.

The sphere is the Gaussian associated one. The linear algebraic fit is the start; Gauss-Newton then minimises the
squared distances. Each step is one compiled pass, because the fit runs over every pixel of field and samples.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from device.surface import Float32Array, Float64Array, MaskArray
from host_sync.errors import MeasurementError
from host_sync.kernels.jit import njit
from host_sync.measurement.geometry import MIN_FRACTION, SkinPlaces
from host_sync.profile.profile_line import bilinear

RAYS: Final = 360
REACH: Final = 0.4
"""Rays run from one less this fraction of the radius to one more."""

LEVEL_FRACTION: Final = 0.2
"""Fraction of a ray at either end that gives the level inside and outside."""

MIN_STEP_FRACTION: Final = 0.3
"""A ray counts if its step is at least this fraction of the median ray's, to the same side."""

MIN_RAYS: Final = RAYS // 6
MAX_STEP_SPREAD: Final = 0.35
"""Largest median deviation of the rays' steps, in their median: edges have 0.2 or less, slopes and noise 0.45 on."""

MAX_OFF_FRACTION: Final = 0.06
"""Largest median distance of the places from the circle, radii: edges that lie anywhere on their rays have 0.2."""

MIN_EDGE: Final = 0.02
"""Least share of the rays' variance that an edge leaves over a polynomial of the second degree; a sharp one leaves a
quarter, a flank over half of the rays a twentieth."""

TUKEY: Final = 4.685
ROUNDS: Final = 12
MIN_RADIUS_PX: Final = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class Circle:
    """A circle, µm from the centre of the first pixel.

    grid : column, row and radius on the grid of pixels, where it is drawn
    column_um, row_um, radius_um : on the skin
    roundness_um : largest minus smallest distance of the edge from the centre, of the places that belong to it
    step_um : height inside above outside, median
    share : fraction of the rays that belong to it
    """

    grid: tuple[float, float, float]
    column_um: float
    row_um: float
    radius_um: float
    roundness_um: float
    step_um: float
    share: float


def find_circle(
    z_um: Float32Array, places: SkinPlaces, centre_um: tuple[float, float], radius_um: float, level: float = 0.5
) -> Circle:
    """Return the circle near a place and radius on the grid of pixels.

    places : of the pixels
    level : where the edge lies between the heights outside (0) and inside (1)

    Raises
    ------
    MeasurementError
        There is no edge around the place.
    """
    pitch_um = places.pitch_um
    if radius_um < MIN_RADIUS_PX * pitch_um:
        raise MeasurementError(f"a circle needs a radius of {MIN_RADIUS_PX * pitch_um:g} µm or more: draw it larger")
    across_um = float(np.hypot(*z_um.shape)) * pitch_um
    if radius_um > across_um:
        raise MeasurementError(
            f"a circle of {radius_um:g} µm radius does not fit into a field of {across_um:.0f} µm: draw it smaller"
        )
    column_um, row_um, again_um = _once(z_um, places, np.array(centre_um, np.float64), radius_um, level, np.inf).grid
    return _once(z_um, places, np.array([column_um, row_um]), again_um, level, MAX_STEP_SPREAD)


def _once(
    z_um: Float32Array, places: SkinPlaces, centre: Float64Array, radius_um: float, level: float, max_spread: float
) -> Circle:
    angle = np.arange(RAYS) * (2.0 * np.pi / RAYS)
    way = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    count = max(16, int(np.ceil(2.0 * REACH * radius_um / (0.5 * places.pitch_um))))
    along = radius_um * np.linspace(1.0 - REACH, 1.0 + REACH, count)
    heights, seen = bilinear(z_um, (centre + along[None, :, None] * way[:, None]) / places.pitch_um)
    heights = np.where(seen, heights, np.nan)
    part = max(2, round(LEVEL_FRACTION * count))
    whole = seen[:, :part].any(axis=1) & seen[:, -part:].any(axis=1)
    inside, outside = np.full(RAYS, np.nan), np.full(RAYS, np.nan)
    inside[whole] = np.nanmedian(heights[whole, :part], axis=1)
    outside[whole] = np.nanmedian(heights[whole, -part:], axis=1)
    step = inside - outside
    usual = float(np.nanmedian(step)) if whole.any() else 0.0
    used = whole & (step * np.sign(usual) > MIN_STEP_FRACTION * abs(usual))
    edge = np.full(RAYS, np.nan)
    for ray in np.flatnonzero(used):
        edge[ray] = _crossing(along, (heights[ray] - outside[ray]) / step[ray], radius_um, level)
    known = np.isfinite(edge)
    problem = (
        f"no round edge near ({centre[0]:.0f}, {centre[1]:.0f}) µm with a radius of {radius_um:.0f} µm: draw the "
        "circle along the edge"
    )
    if known.sum() < MIN_RAYS or np.nanmedian(np.abs(step - usual)) > max_spread * abs(usual) or usual == 0.0:
        raise MeasurementError(problem)
    if _is_bent_plane(along[None, :, None] * way[known, None], heights[known], radius_um):
        raise MeasurementError(problem)
    seen_um = centre + edge[known, None] * way[known]
    column, row, radius, weight = _fitted(seen_um)
    if not 0.0 < radius < np.inf or weight.sum() == 0.0:
        raise MeasurementError(problem)
    distance = np.hypot(*(seen_um - (column, row)).T)
    if np.median(np.abs(distance - radius)) > MAX_OFF_FRACTION * radius:
        raise MeasurementError(problem)
    grid = column, row, radius
    skin_um = places.of_seen(seen_um, outside[known] + level * step[known])
    column, row, radius, weight = _fitted(skin_um)
    kept = np.hypot(*(skin_um - (column, row)).T)[weight > 0.0]
    return Circle(grid, column, row, radius, float(np.ptp(kept)), usual, kept.size / RAYS)


def _is_bent_plane(from_centre: Float64Array, heights: Float64Array, radius_um: float) -> bool:
    """Return whether a polynomial of the second degree describes the rays: a slope, a dome or a cylinder has no edge.

    from_centre : (column, row), shape (N, M, 2), µm
    heights : of the same places, shape (N, M), µm
    """
    seen = np.isfinite(heights)
    x, y = from_centre[seen].T / radius_um
    z = heights[seen]
    design = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1)
    left = z - design @ np.linalg.lstsq(design, z, rcond=None)[0]
    return bool(left.var() < MIN_EDGE * z.var())


def _crossing(along: Float64Array, share: Float64Array, near_um: float, level: float) -> float:
    """Return the distance nearest to `near_um` where `share` falls through a level; NaN where it does not."""
    at = np.flatnonzero((share[:-1] > level) != (share[1:] > level))
    at = at[np.isfinite(share[at]) & np.isfinite(share[at + 1])]
    if not at.size:
        return float("nan")
    places = along[at] + (level - share[at]) / (share[at + 1] - share[at]) * (along[1] - along[0])
    return float(places[int(np.abs(places - near_um).argmin())])


def _fitted(places: Float64Array) -> tuple[float, float, float, Float64Array]:
    """Return the column, row and radius of the circle through places of shape (N, 2), and the weight of each."""
    weight = np.ones(len(places))
    design = np.column_stack([2.0 * places, np.ones(len(places))])
    column, row, rest = np.linalg.lstsq(design, (places**2).sum(axis=1), rcond=None)[0]
    radius = float(np.sqrt(max(rest + column**2 + row**2, 0.0)))
    for _ in range(ROUNDS):
        off = places - (column, row)
        distance = np.maximum(np.hypot(*off.T), 1e-12)
        residual = distance - radius
        spread = max(TUKEY * 1.4826 * float(np.median(np.abs(residual))), 1e-9 * radius)
        weight = np.clip(1.0 - (residual / spread) ** 2, 0.0, None) ** 2
        root = np.sqrt(weight)
        slopes = np.column_stack([off / distance[:, None], np.ones(len(places))])
        change = np.linalg.lstsq(slopes * root[:, None], residual * root, rcond=None)[0]
        column, row, radius = column + change[0], row + change[1], radius + change[2]
    return float(column), float(row), float(radius), weight


# Least-squares sphere of a surface.

MAX_STEPS: Final = 40

ENOUGH: Final = 1e-9
"""Step, as a fraction of the radius, that ends the iteration."""

MAX_RADIUS_RATIO: Final = 1e4
"""A radius of more than this many field widths counts as a plane."""


@dataclass(frozen=True, slots=True)
class Sphere:
    """A sphere, lengths in µm; column and row of the centre from the centre of the first pixel.

    radius_um : positive for a bulge, negative for a hollow
    residual_um : RMS distance of the pixels from it
    """

    column_um: float
    row_um: float
    height_um: float
    radius_um: float
    residual_um: float


class SphereForm:
    """Subtracts the least-squares sphere from a surface, along the height.

    Parameters
    ----------
    places : of its pixels
    """

    def __init__(self, places: SkinPlaces) -> None:
        self._places = places
        self._last: Sphere | None = None
        self._beside: MaskArray | None = None

    def remove(self, z_um: Float32Array) -> Float32Array:
        """Return heights above the sphere: float32 array of shape (H, W), NaN where invalid or beside the sphere.

        Pixels beside the first surface's sphere stay invalid in later ones, so that a surface and its samples are
        compared on the same pixels.
        """
        self._last = sphere = fit_sphere(z_um, self._places, self._last)
        across_um, down_um = self._places.at(z_um)
        reach = sphere.radius_um**2 - (across_um - sphere.column_um) ** 2 - (down_um - sphere.row_um) ** 2
        if self._beside is None:
            self._beside = reach <= 0.0
        cap = np.sqrt(np.maximum(reach, 0.0))
        left = z_um - (sphere.height_um + np.sign(sphere.radius_um) * cap)
        return np.where(self._beside, np.nan, left).astype(np.float32)


def fit_sphere(z_um: Float32Array, places: SkinPlaces, start: Sphere | None = None) -> Sphere:
    """Return the least-squares sphere of the valid pixels of a surface.

    places : of its pixels
    start : a sphere close to it, if known

    Raises
    ------
    MeasurementError
        There are fewer than four valid pixels, or they show no curvature.
    """
    valid = np.isfinite(z_um)
    if valid.sum() < 4:
        raise MeasurementError(f"a sphere needs four valid pixels, found {int(valid.sum())}: widen the region")
    width_um = places.pitch_um * max(z_um.shape)
    middle = start or _algebraic(z_um, valid, places.pitch_um)
    grid = np.array([places.pitch_um, *places.middle_um, places.nearness_per_um, *places.level, MIN_FRACTION])
    state = np.array([middle.column_um, middle.row_um, middle.height_um, abs(middle.radius_um)])
    for _ in range(MAX_STEPS):
        normal, right, _ = _step(z_um, grid, state)
        try:
            change = np.linalg.solve(normal, right)
        except np.linalg.LinAlgError:
            break
        state = state + change
        if not np.isfinite(state).all() or state[3] > MAX_RADIUS_RATIO * width_um:
            break
        if np.abs(change).max() < ENOUGH * state[3]:
            _, _, square = _step(z_um, grid, state)
            side = 1.0 if np.median(z_um[valid]) > state[2] else -1.0
            column, row, height, radius = (float(value) for value in state)
            return Sphere(column, row, height, side * radius, float(np.sqrt(square / valid.sum())))
    raise MeasurementError("the surface shows no sphere: it is too flat, or the region holds something else")


def _algebraic(z_um: Float32Array, valid: MaskArray, pitch_um: float) -> Sphere:
    """Return the sphere of the linear fit x² + y² + z² = 2 a x + 2 b y + 2 c z + d."""
    row, column = (index * pitch_um for index in np.nonzero(valid))
    step = max(1, row.size // 200_000)
    places: Float64Array = np.stack([column, row, z_um[valid].astype(np.float64), np.ones(row.size)], axis=-1)[::step]
    middle = places.mean(axis=0)
    middle[3] = 0.0
    places = places - middle
    scale = max(float(np.abs(places[:, :3]).max()), 1e-30)
    places[:, :3] /= scale
    square = (places[:, :3] ** 2).sum(axis=1)
    a, b, c, d = np.linalg.lstsq(places, square, rcond=None)[0]
    column_um, row_um, height_um = 0.5 * scale * np.array([a, b, c]) + middle[:3]
    radius_um = scale * float(np.sqrt(max(d + 0.25 * (a * a + b * b + c * c), 1e-30)))
    return Sphere(float(column_um), float(row_um), float(height_um), radius_um, 0.0)


@njit(cache=True)
def _step(z_um: Any, grid: Any, state: Any) -> tuple[Float64Array, Float64Array, float]:
    """Return the normal equations of one Gauss-Newton step, and the sum of squared distances."""
    rows, columns = z_um.shape
    normal, right, square = np.zeros((4, 4)), np.zeros(4), 0.0
    gradient = np.empty(4)
    gradient[3] = -1.0
    pitch_um, across_um, down_um, nearness, zero, across, down, least = grid
    for r in range(rows):
        for c in range(columns):
            z = z_um[r, c]
            if not np.isfinite(z):
                continue
            x, y = c * pitch_um - across_um, r * pitch_um - down_um
            share = max(1.0 - nearness * (z + zero + across * x + down * y), least)
            x, y = across_um + x * share - state[0], down_um + y * share - state[1]
            h = z - state[2]
            distance = max(np.sqrt(x * x + y * y + h * h), 1e-12)  # a centre on a pixel has no direction
            gradient[0], gradient[1], gradient[2] = -x / distance, -y / distance, -h / distance
            off = distance - state[3]
            square += off * off
            for i in range(4):
                right[i] -= gradient[i] * off
                for j in range(4):
                    normal[i, j] += gradient[i] * gradient[j]
    return normal, right, square
