"""The models that turn the intensity of prepared presses into slopes, and their errors on held-out balls."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import count
from typing import Final

import numpy as np
from numpy.typing import NDArray

from device.balls.sphere import MIN_HEIGHTS, Ball, BallSamples, Viewpoint, gather_samples, pixels_inside, sphere_slopes
from device.calibration.fit import BegunFit, InverseFit
from device.errors import CalibrationError
from device.imaging.flat_field import NormalizedImage
from device.inverse_map.model import REST_NODES, InverseMap, slope_sigma_of
from device.inverse_map.near_light import IlluminationMap
from device.inverse_map.noise_bias import correct_noise_bias
from device.surface import Float32Array, Float64Array, MaskArray
from host_sync.calibration.balls import UsedPress, apply_fit
from host_sync.calibration.preparation import PreparedPresses, in_reference_light, pressed
from host_sync.calibration.radii import Centres, fit_to, fit_to_best_balls, without_disagreement
from host_sync.gradients.inverse_map_kernel import cell_slopes
from host_sync.kernels.cell_rows import middles_of_cells
from host_sync.light.fit import FittedLight, Press, confirmed_fraction, fit_light_of_presses, held_out_readers
from host_sync.light.model import Position
from host_sync.uncertainty.elevation import ElevationCorrection, apexes_px, elevation_correction
from host_sync.uncertainty.slope_error import SlopeError, measure_slope_error


@dataclass(frozen=True, eq=False)
class SlopeModels:
    """Models of a calibration.

    used : the presses that they were fitted to
    centres : where the balls' centres came from before they were refined
    inverse : the position-aware inverse map and its held-out errors
    viewpoint : where the camera looks from, None where it is not known
    lowered : the forward model of the sensor's light, and the balls at the elevation of skin at rest
    removes_light : gains and offsets of the presses were removed
    """

    used: Sequence[UsedPress]
    centres: Centres
    inverse: InverseFit
    viewpoint: Viewpoint | None
    lowered: LoweredBalls
    removes_light: bool

    @classmethod
    def of(
        cls,
        prepared: PreparedPresses,
        lights_mm: Sequence[Position],
        pupil_height_mm: float | None,
        report_progress: Callable[[str], None],
    ) -> SlopeModels:
        """Fit the models to presses; arguments and errors as for `calibrate`."""
        report_progress("fitting the position-aware inverse map")
        illumination = prepared.illumination
        begun, located, centres = fit_to_best_balls(prepared.frames, prepared.located, illumination)
        located, begun, removes_light = _in_best_light(prepared, located, begun, illumination)
        located, begun = without_disagreement(located, begun, illumination)
        viewpoint = _viewpoint(prepared, pupil_height_mm)
        if viewpoint is not None:
            report_progress("fitting it again as the camera sees the balls")
            located = seen_from(located, begun.fit.map, viewpoint)
            begun = fit_to(located, illumination, begun)
        report_progress("fitting the light model")
        columns = prepared.flat_field.shape[1]
        positions = np.asarray(lights_mm, np.float64) * (1e3 / prepared.pitch_um / columns) if lights_mm else None
        lowered = LoweredBalls.of(located, begun.fit, slope_sigma_of(begun.fit.held_out_deg), positions)
        if lowered.light.has_sources:
            located = lowered.presses
            begun = fit_to(located, illumination, begun)
        inverse = begun.finished()
        inverse = replace(inverse, map=correct_noise_bias(inverse.map, [press.intensity for press in located]))
        if prepared.reference:
            inverse = replace(inverse, map=correct_flat_bias(inverse.map, pressed(located)))
        return cls(apply_fit(located, inverse), centres, inverse, viewpoint, lowered, removes_light)

    @cached_property
    def pressed(self) -> list[Press]:
        """Intensity and balls of each press."""
        return pressed(self.used)

    @cached_property
    def training(self) -> BallSamples:
        """Pixels of the balls."""
        return gather_samples(self.pressed)

    def held_out(self) -> tuple[FittedLight, ElevationCorrection, SlopeError]:
        """Return the light model with its confirmed fraction, the balls' elevation, and the error of held-out balls."""
        presses, inverse, lowered = self.pressed, self.inverse, self.lowered
        prior_sigma = slope_sigma_of(inverse.held_out_deg)
        seen = elevation_correction(presses, self.training, inverse.map)
        elevation = lowered.elevation(seen)
        maps = inverse.replicas or (inverse.map,)
        confirmed = confirmed_fraction(lowered.light, maps, presses, elevation, prior_sigma)
        light = replace(lowered.light, confirmed=confirmed)
        over_cells = held_out_readers(light, inverse.map, presses, elevation, prior_sigma) if confirmed else None
        left = seen.shared(light.model.uncertain_fraction(prior_sigma)) if light.has_sources else seen
        return light, elevation, measure_slope_error(presses, self.training, inverse, left, over_cells)


def _in_best_light(
    prepared: PreparedPresses, located: Sequence[UsedPress], begun: BegunFit, illumination: IlluminationMap | None
) -> tuple[Sequence[UsedPress], BegunFit, bool]:
    """Return presses and inverse map with the gains and offsets of presses removed, where held-out balls confirm it.

    On some sensors the skin around a ball changes its light as no light source does, and what resembles a gain is none.
    """
    if not any(light.change or light.stray for light in prepared.lights):
        return located, begun, True
    lit = in_reference_light(located, prepared.lights, prepared.flat_field)
    again = fit_to(lit, illumination)
    before_deg, after_deg = begun.fit.held_out_deg, again.fit.held_out_deg
    if before_deg is None or after_deg is None or after_deg > before_deg:
        return located, begun, False
    return lit, again, True


def _viewpoint(prepared: PreparedPresses, pupil_height_mm: float | None) -> Viewpoint | None:
    """Return where the camera looks from; a grid's pitch is that at the balls' tops, as the camera sees it."""
    if pupil_height_mm is None or prepared.measured_pitch is not None:
        return None
    rows, columns, _ = prepared.flat_field.shape
    return Viewpoint.over_middle(pupil_height_mm, prepared.pitch_um, (rows, columns))


# Balls of presses as a camera sees them that stands near the skin.


def seen_from(located: Sequence[UsedPress], inverse: InverseMap, viewpoint: Viewpoint) -> list[UsedPress]:
    """Return the presses with balls as a camera sees them that is not far away.

    Raises
    ------
    CalibrationError
        The camera would stand hardly higher than the balls.
    """
    seen = [
        replace(
            press,
            balls=tuple(
                replace(ball, viewpoint=viewpoint, apex_px=apex_px)
                for ball, apex_px in zip(press.balls, apexes_px(press.intensity, press.balls, inverse), strict=True)
            ),
        )
        for press in located
    ]
    highest_px = max((ball.apex_px for press in seen for ball in press.balls), default=0.0)
    if viewpoint.height_px < MIN_HEIGHTS * highest_px:
        raise CalibrationError(
            f"the camera's pupil is stated {viewpoint.height_px:.0f} px over the skin and a ball rises "
            f"{highest_px:.0f} px: check pupil_height_mm"
        )
    return seen


# Balls of presses as they would look at the elevation of skin at rest, for the fit of the inverse map.
#
# A ball's apex stands high over the skin, its rim lower, and near light reaches both at other angles. The inverse map
# knows no elevation: it is fitted to what the light model predicts at rest, as far as the model explains the balls.

CHANGE: Final = (0.5, 2.0)
"""Bounds of what elevation may change the intensity by: beyond them the model is extrapolated."""


@dataclass(frozen=True, slots=True, eq=False)
class LoweredBalls:
    """Presses whose balls were lowered.

    light : the light model of the balls as they were seen
    presses : the presses with lowered balls
    remaining : fraction of a ball's elevation that its intensity still shows
    """

    light: FittedLight
    presses: tuple[UsedPress, ...]
    remaining: float

    @classmethod
    def of(
        cls, located: Sequence[UsedPress], fit: InverseFit, prior_sigma: float, positions: Float64Array | None
    ) -> LoweredBalls:
        """Fit the light model to the balls that follow their spheres, and lower these.

        fit : of the inverse map to the presses as they were seen
        prior_sigma : standard uncertainty of its slopes
        positions : stated places of the sources, see `fit_light`
        """
        used = apply_fit(located, fit)
        pressed = [(press.intensity, press.balls) for press in used]
        apexes = [apex_px for image, balls in pressed if balls for apex_px in apexes_px(image, balls, fit.map)]
        light = fit_light_of_presses(pressed, fit.map, apexes, positions)
        remaining = 1.0 - light.model.believed_fraction(prior_sigma)
        places = iter(zip(apexes, light.shift_px, strict=True))
        numbers = count()
        lowered = []
        for press in located:
            image, balls = press.intensity, []
            values = image.values.copy()
            for _ in press.balls:
                number = next(numbers)
                ball = fit.balls[number]
                if fit.kept[number]:
                    apex_px, shift = next(places)
                    across, down = ((1.0 - remaining) * shift).tolist()
                    ball = replace(ball, column=ball.column + across, row=ball.row + down)
                    _lower(values, image, ball, apex_px, light, 1.0 - remaining)
                balls.append(ball)
            lowered.append(replace(press, intensity=replace(image, values=values), balls=tuple(balls)))
        return cls(light, tuple(lowered), remaining)

    def elevation(self, seen: ElevationCorrection) -> ElevationCorrection:
        """Return at which elevation the lowered balls show each slope, from where they stood."""
        return ElevationCorrection(self.remaining * seen.apex_px, self.remaining * seen.radius_px, seen.nearness_per_px)


def _lower(
    values: Float32Array, image: NormalizedImage, ball: Ball, apex_px: float, light: FittedLight, fraction: float
) -> None:
    """Write the intensity (H, W, C) of a ball at the elevation of skin at rest over that of its contact."""
    row, column = pixels_inside(ball, image.shape)
    p, q = (part.astype(np.float64) for part in sphere_slopes(ball, column.astype(np.float32), row.astype(np.float32)))
    z_px = apex_px - ball.radius_px * (1.0 - 1.0 / np.sqrt(1.0 + p * p + q * q))
    model = light.model
    x, y, z = model.places(column.astype(np.float64), row.astype(np.float64), z_px)
    low, high = (np.maximum(model.mixed(model.light(p, q, x, y, at)), 1e-3) for at in (np.zeros_like(z), z))
    change = 1.0 + fraction * (np.clip(low / high, *CHANGE) - 1.0)
    values[row, column] *= change.astype(np.float32)


# Correction of the reference from the free skin of all presses.
#
# One frame of untouched skin has noise of its own, whose long waves add up to height: the same in every scan, as much
# as 0.6 µm on a quiet sensor. Far from their balls presses show untouched skin again. What the map reads there, as far
# as the presses agree, is taken off all slopes. Where presses show too little free skin, differ, or show more than a
# reference's noise can be, nothing is.

FREE_RADII: Final = 4.0
"""Distance from a ball's centre, in contact radii, from which skin is untouched."""

MAX_SLOPE: Final = 0.03
"""Steeper skin is not untouched, or is another gel's."""

MAX_MISSED: Final = 0.004
"""Root mean square slope that a reference's noise may be read as; more is skin that changed since.

Rendered sensors show 0.0003 to 0.0023, a real one whose skin drifts from press to press 0.011.
"""

MAX_CELLS: Final = 40_000
"""A press is reduced to so many cells at most."""

MIN_CELLS: Final = 12
"""Cells of a press around a node that determine its slope."""

MIN_PRESSES: Final = 4
MEDIAN_VARIANCE: Final = 1.5
"""Variance of a median over that of a mean, about π / 2."""

Pressed = Sequence[tuple[NormalizedImage, Sequence[Ball]]]


def correct_flat_bias(inverse_map: InverseMap, pressed: Pressed) -> InverseMap:
    """Return the map less what it reads on the free skin of presses, in `noise_bias`.

    pressed : intensity and every ball of each press
    """
    bias = inverse_map.noise_bias
    shape = _node_shape(inverse_map) if bias is None else (bias.shape[0], bias.shape[1])
    read = free_skin_slopes(inverse_map, pressed, shape)
    return replace(inverse_map, noise_bias=read if bias is None else np.asarray(bias + read, np.float32))


def free_skin_slopes(inverse_map: InverseMap, pressed: Pressed, shape: tuple[int, int]) -> Float32Array:
    """Return the slopes that presses agree on where their skin is free, float32 array (h, w, 2).

    Nodes are even over the field. Each node's median over presses is reduced by the share of its square that is noise;
    0 where fewer than `MIN_PRESSES` show free skin.
    """
    parts = [_at_nodes(inverse_map, image, balls, shape) for image, balls in pressed if balls]
    if len(parts) < MIN_PRESSES:
        return np.zeros((*shape, 2), np.float32)
    stack = np.stack(parts)
    count = np.isfinite(stack[..., 0]).sum(axis=0)
    shown = count >= MIN_PRESSES
    median, spread = np.zeros((*shape, 2)), np.ones((*shape, 2))
    median[shown] = np.nanmedian(stack[:, shown], axis=0)
    spread[shown] = np.nanvar(stack[:, shown], axis=0)
    noise = MEDIAN_VARIANCE * spread.sum(axis=-1) / np.maximum(count - 1, 1)
    square = (median**2).sum(axis=-1)
    believed = np.where(shown, square / np.maximum(square + noise, 1e-30), 0.0)
    if not shown.any() or np.sqrt(square[shown].mean()) > MAX_MISSED:
        return np.zeros((*shape, 2), np.float32)
    return np.asarray(median * believed[..., None], np.float32)


def _at_nodes(
    inverse_map: InverseMap, image: NormalizedImage, balls: Sequence[Ball], shape: tuple[int, int]
) -> Float64Array:
    """Return the mean slopes of a press's free skin around each node, float64 array (h, w, 2).

    NaN where there is too little free skin.
    """
    rows, columns = image.shape
    step = max(int(np.ceil(np.sqrt(rows * columns / MAX_CELLS))), 1)
    read = cell_slopes(image, inverse_map, step)
    down, across = middles_of_cells(read.p.shape, step)
    free = read.valid & (np.hypot(read.p, read.q) < MAX_SLOPE) & _far(balls, across, down)
    node = [
        np.rint(at / max(size - 1, 1) * (count - 1)).astype(np.intp).clip(0, count - 1)
        for at, size, count in zip((down, across), (rows, columns), shape, strict=True)
    ]
    index = (node[0][:, None] * shape[1] + node[1])[free]
    total = shape[0] * shape[1]
    number = np.bincount(index, minlength=total)
    sums = [np.bincount(index, slopes[free], total) for slopes in (read.p, read.q)]
    mean = np.stack(sums, axis=-1) / np.maximum(number, 1)[:, None]
    mean[number < MIN_CELLS] = np.nan
    return np.asarray(mean.reshape(*shape, 2))


def _far(balls: Sequence[Ball], across: NDArray[np.floating], down: NDArray[np.floating]) -> MaskArray:
    """Return where no ball has touched: bool array (h, w)."""
    far = np.ones((len(down), len(across)), np.bool_)
    for ball in balls:
        distance = np.hypot(across[None] - ball.column, down[:, None] - ball.row)
        far &= distance > FREE_RADII * ball.contact_radius_px
    return far


def _node_shape(inverse_map: InverseMap) -> tuple[int, int]:
    rows, columns = inverse_map.shape
    return max(round(REST_NODES * rows / columns), 2), REST_NODES
