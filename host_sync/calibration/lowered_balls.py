"""Balls of presses as they would look at the elevation of skin at rest, for the fit of the inverse map.

A ball's apex stands high over the skin, its rim lower, and near light reaches both at other angles. The inverse map
knows no elevation: it is fitted to what the light model predicts at rest, as far as the model explains the balls.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import count
from typing import Final

import numpy as np

from device.balls.sphere import Ball, pixels_inside, sphere_slopes
from device.calibration.fit import InverseFit
from device.imaging.flat_field import NormalizedImage
from device.surface.fields import Float32Array, Float64Array
from host_sync.calibration.balls import UsedPress, apply_fit
from host_sync.light.fit import FittedLight
from host_sync.light.presses import fit_light_of_presses
from host_sync.uncertainty.elevation import ElevationCorrection, apexes_px

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
