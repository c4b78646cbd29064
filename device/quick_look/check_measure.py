"""A check standard measured in a quick look: radius of a ball, height of a step, Ra of a roughness specimen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from device.bundles.check import UNITS, CheckStandard, StandardKind
from device.errors import DeviceError
from device.quick_look.measures import MIN_CUTOFF_PX, RUN_UP, levelled, mean_line
from device.quick_look.solver import QuickLook
from device.surface import Float32Array, Float64Array, GradientField, HeightMap

SMOOTH_PX: Final = 5
INNER: Final = 0.75
"""Fraction of the radius of its steepest ring within which a ball is fitted: beyond, the skin leaves it."""

PLAUSIBLE: Final[dict[StandardKind, float]] = {"ball": 1.5, "step": 1.5, "roughness": 2.0}
"""What reads more than so many times too large or too small under right light is another object than the standard."""

SEEN: Final[dict[StandardKind, str]] = {
    "ball": "a ball of radius",
    "step": "a step of",
    "roughness": "a roughness Ra of",
}

MIN_EXPLAINED: Final = 0.8
"""Fraction of the slopes' square that a ball must explain."""

TILES: Final = 3
MAX_UNEVEN: Final = 2.0
"""A roughness specimen covers the middle alike: no tile of 3 × 3 is rougher or finer than their median by more."""

NO_BALL: Final = "no ball was found: press the ball of the check standard in the middle of the field"
MIN_PIXELS: Final = 60
ROUNDS: Final = 8
GAP_UM: Final = 250.0
REACH_UM: Final = 900.0
STRIP_UM: Final = 1000.0
"""A step is fitted between these distances from its edge, in a strip this wide to both sides: nearer the skin bridges
the edge, farther away the quick look drifts."""

EDGE_WEIGHT: Final = 6
"""The edge lies where the slope, to this power, does."""

MIN_STEP: Final = 3.0
"""A step must stand out of what its two faces leave by this factor."""

NO_STEP: Final = "no step was found: press it so that its edge crosses the middle of the field"
ROUGHNESS_CUTOFF_UM: Final = 800.0
MIDDLE: Final = 0.5
STEP_MIDDLE: Final = 0.3
"""Fractions of the field, in each direction, that a roughness specimen or the two faces of a step must cover."""


class CheckNotMeasured(DeviceError):
    """The quick look does not show the check standard."""


def measure_standard(standard: CheckStandard, look: QuickLook, bias: BallBias | None = None) -> float:
    """Return the value of a check standard, µm.

    bias : of balls in this calibration's quick looks; None: not known

    Raises
    ------
    CheckNotMeasured
        It does not show; says what to do.
    """
    found = _measured(standard.kind, look, bias)
    factor = PLAUSIBLE[standard.kind]
    if not 1.0 / factor < found / standard.value_um < factor:
        unit, scale = UNITS[standard.kind]
        seen, expected = (f"{value / scale:.3g} {unit}" for value in (found, standard.value_um))
        raise CheckNotMeasured(
            f"{SEEN[standard.kind]} {seen} was seen, {expected} expected: press {standard.name}, or calibrate again if "
            "this is it"
        )
    return found


def _measured(kind: StandardKind, look: QuickLook, bias: BallBias | None) -> float:
    match kind:
        case "ball":
            reading = read_ball(look.gradients, look.height)
            return bias.corrected_um(reading) if bias else reading.radius_um
        case "step":
            return step_um(look.height)
        case "roughness":
            return roughness_um(look.height)


def read_ball(slopes: GradientField, height: HeightMap) -> BallReading:
    """Return radius and height of the pressed ball as the quick look shows it.

    The sine of the slope grows with the distance from the ball's top as 1 / R.
    """
    steep = 1.0 / np.sqrt(1.0 + slopes.p.astype(np.float64) ** 2 + slopes.q.astype(np.float64) ** 2)
    across, down = slopes.p * steep, slopes.q * steep
    row, column = np.unravel_index(int(np.argmax(_smooth(height.z_um))), height.z_um.shape)
    rows, columns = np.mgrid[: height.z_um.shape[0], : height.z_um.shape[1]]
    centre: tuple[float, float] = float(row), float(column)
    distance = np.hypot(rows - centre[0], columns - centre[1])
    sine = np.hypot(across, down)
    rings = distance.astype(int)
    counted = np.bincount(rings.ravel(), slopes.valid.ravel().astype(float))
    mean = np.bincount(rings.ravel(), (sine * slopes.valid).ravel()) / np.maximum(counted, 1.0)
    edge_px = float(np.argmax(np.where(counted > 0, mean, 0.0)))
    radius_um, explained = float("nan"), 0.0
    for _ in range(ROUNDS):
        inside = slopes.valid & (np.hypot(rows - centre[0], columns - centre[1]) < INNER * edge_px)
        if inside.sum() < MIN_PIXELS:
            raise CheckNotMeasured(NO_BALL)
        x, y = columns[inside].astype(np.float64), rows[inside].astype(np.float64)
        ones, zeros = np.ones(x.size), np.zeros(x.size)
        # across = a - k x, down = b - k y
        design = np.concatenate([np.stack([-x, ones, zeros], -1), np.stack([-y, zeros, ones], -1)])
        seen = np.concatenate([across[inside], down[inside]])
        (k, a, b), *_ = np.linalg.lstsq(design, seen, rcond=None)
        explained = 1.0 - float(np.sum((seen - design @ (k, a, b)) ** 2) / max(float(np.sum(seen**2)), 1e-12))
        if not k > 0.0:
            raise CheckNotMeasured(NO_BALL)
        centre, radius_um = (float(b / k), float(a / k)), float(height.pitch_um / k)
    if explained < MIN_EXPLAINED:
        raise CheckNotMeasured(NO_BALL)
    return BallReading(radius_um, float(np.nanmax(height.z_um) - np.nanmedian(height.z_um)))


def step_um(height: HeightMap) -> float:
    """Return the height of the step whose edge crosses the middle of the field: two parallel lines beside the edge."""
    part = _middle(height.z_um, STEP_MIDDLE)
    down, across = np.gradient(_smooth(part))
    weight = np.hypot(down, across) ** EDGE_WEIGHT
    total = float(weight.sum())
    if not total > 0.0:
        raise CheckNotMeasured(NO_STEP)
    rows, columns = np.mgrid[: part.shape[0], : part.shape[1]]
    row, column = float((weight * rows).sum()) / total, float((weight * columns).sum()) / total
    steep = np.maximum(weight ** (1.0 / EDGE_WEIGHT), 1e-12)
    unit = np.stack([down / steep, across / steep], -1)
    _, vectors = np.linalg.eigh(np.einsum("hw,hwi,hwj->ij", weight, unit, unit))
    normal = vectors[:, -1]
    beside = ((rows - row) * normal[0] + (columns - column) * normal[1]) * height.pitch_um
    along = ((rows - row) * -normal[1] + (columns - column) * normal[0]) * height.pitch_um
    near = np.isfinite(part) & (np.abs(along) < STRIP_UM)
    used = near & (np.abs(beside) > GAP_UM) & (np.abs(beside) < REACH_UM)
    if min((used & (beside > 0.0)).sum(), (used & (beside < 0.0)).sum()) < MIN_PIXELS:
        raise CheckNotMeasured(NO_STEP)
    side = np.sign(beside[used])
    design = np.stack([beside[used], along[used], np.ones(side.size), side], -1)
    fitted, *_ = np.linalg.lstsq(design, part[used].astype(np.float64), rcond=None)
    residual = float(np.std(design @ fitted - part[used]))
    rise = 2.0 * abs(float(fitted[3]))
    if not rise > MIN_STEP * residual:
        raise CheckNotMeasured(NO_STEP)
    return rise


def roughness_um(height: HeightMap) -> float:
    """Ra over the middle of the field: mean over its rows with a cut-off of 0.8 mm, without a run-up at either end."""
    part = levelled(_middle(height.z_um, MIDDLE)).astype(np.float64)
    cutoff = ROUGHNESS_CUTOFF_UM / height.pitch_um
    end = round(RUN_UP * cutoff)
    if cutoff < MIN_CUTOFF_PX or part.shape[1] <= 2 * end + cutoff:
        raise CheckNotMeasured(
            f"the quick look's pixels of {height.pitch_um:.0f} µm are too few for a cut-off of "
            f"{ROUGHNESS_CUTOFF_UM / 1e3:g} mm: check with a ball or a step"
        )
    rough = np.stack([np.abs(line - mean_line(line, cutoff))[end : part.shape[1] - end] for line in part])
    if not np.isfinite(rough).any(axis=1).any():
        raise CheckNotMeasured("the middle of the field has no heights: press the roughness specimen again")
    tiles = [_mean(tile) for band in np.array_split(rough, TILES) for tile in np.array_split(band, TILES, axis=1)]
    usual = float(np.median(tiles))
    if not usual / MAX_UNEVEN < min(tiles) <= max(tiles) < usual * MAX_UNEVEN:
        raise CheckNotMeasured("the middle of the field is not evenly rough: press the specimen flat on the middle")
    return float(np.mean([np.nanmean(line) for line in rough if np.isfinite(line).any()]))


def _mean(part: Float64Array) -> float:
    return float(np.nanmean(part)) if np.isfinite(part).any() else float("nan")


def _smooth(z_um: Float32Array) -> Float64Array:
    """Return the box mean over `SMOOTH_PX` pixels."""
    side = np.ones(SMOOTH_PX) / SMOOTH_PX
    padded = np.pad(np.nan_to_num(z_um).astype(np.float64), SMOOTH_PX // 2, mode="edge")
    down = np.apply_along_axis(np.convolve, 0, padded, side, "valid")
    return np.asarray(np.apply_along_axis(np.convolve, 1, down, side, "valid"))


def _middle(z_um: Float32Array, fraction: float) -> Float32Array:
    rows, columns = z_um.shape
    top, left = round(rows * (1.0 - fraction) / 2.0), round(columns * (1.0 - fraction) / 2.0)
    return z_um[top : rows - top, left : columns - left]


# Bias of a ball's radius in the quick look, from the calibration's own balls and from its height.
#
# A light of a few millimetres' height comes nearer to skin that is pressed towards it, and shades its slopes more. An
# inverse map knows the height of the balls that it was trained on only: balls that stand lower read too flat.

PositionMm = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class BallReading:
    """A ball in a quick look: radius, and height of its top above the untouched skin, µm."""

    radius_um: float
    top_um: float


@dataclass(frozen=True, slots=True)
class BallBias:
    """Bias that the calibration's own balls have.

    fraction : their radius as read over the stated one, median
    top_um : height of their tops above the untouched skin, median, µm
    lights_mm : position of each light
    """

    fraction: float
    top_um: float
    lights_mm: tuple[PositionMm, ...]

    @classmethod
    def of(
        cls, readings: Sequence[BallReading], stated_um: Sequence[float], lights_mm: Sequence[PositionMm]
    ) -> BallBias:
        """Return the bias of at least one reading, beside the radii that the calibration states."""
        fractions = [reading.radius_um / radius for reading, radius in zip(readings, stated_um, strict=True)]
        tops = [reading.top_um for reading in readings]
        return cls(float(np.median(fractions)), float(np.median(tops)), tuple(lights_mm))

    def corrected_um(self, reading: BallReading) -> float:
        """Return the radius without the bias, µm."""
        lower = shading(self.lights_mm, self.top_um) / shading(self.lights_mm, reading.top_um)
        return reading.radius_um / (self.fraction * lower)


def shading(lights_mm: Sequence[PositionMm], height_um: float) -> float:
    """Return the factor by which skin at a height shows more of its slopes than untouched skin.

    It is the inverse cube of the ratio of the distances of both from a light, in the middle of the field, mean of the
    lights. At most half a light's height counts.
    """
    found = []
    for x, y, z in lights_mm:
        aside, above = float(np.hypot(x, y)), z - min(max(height_um * 1e-3, 0.0), 0.5 * z)
        found.append((np.hypot(aside, z) / np.hypot(aside, above)) ** 3)
    return float(np.mean(found))
