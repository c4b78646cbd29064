"""The models that turn the intensity of prepared presses into slopes, and their errors on held-out balls."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np

from device.balls.sphere import BallSamples, gather_samples
from device.balls.viewpoint import Viewpoint
from device.calibration.fit import BegunFit, InverseFit
from device.inverse_map.illumination import IlluminationMap
from device.inverse_map.noise_bias import less_noise
from host_sync.calibration.ball_choice import Centres, fit_to, fit_to_best_balls
from host_sync.calibration.balls import UsedPress, apply_fit
from host_sync.calibration.free_skin import with_free_skin
from host_sync.calibration.lowered_balls import LoweredBalls
from host_sync.calibration.nearby_camera import seen_from
from host_sync.calibration.preparation import PreparedPresses, in_reference_light, pressed
from host_sync.calibration.radii import without_disagreement
from host_sync.light.fit import FittedLight
from host_sync.light.model import Position
from host_sync.light.presses import Press, confirmed_fraction, held_out_readers
from host_sync.uncertainty.elevation import ElevationCorrection, elevation_correction
from host_sync.uncertainty.slope_error import SlopeError, measure_slope_error

NO_HELD_OUT_DEG: Final = 5.0
"""Error of the inverse map's slopes that is assumed where too few balls were given to hold one out."""


def slope_sigma_of(held_out_deg: float | None) -> float:
    """Return the standard uncertainty of a slope component for a mean angular error, degrees; None if not known."""
    known_deg = held_out_deg if held_out_deg is not None and np.isfinite(held_out_deg) else NO_HELD_OUT_DEG
    return float(np.tan(np.radians(known_deg)) / np.sqrt(np.pi / 2.0))


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
        tell: Callable[[str], None],
    ) -> SlopeModels:
        """Fit the models to presses; arguments and errors as for `calibrate`."""
        tell("fitting the position-aware inverse map")
        illumination = prepared.illumination
        begun, located, centres = fit_to_best_balls(prepared.frames, prepared.located, illumination)
        located, begun, removes_light = _in_best_light(prepared, located, begun, illumination)
        located, begun = without_disagreement(located, begun, illumination)
        viewpoint = _viewpoint(prepared, pupil_height_mm)
        if viewpoint is not None:
            tell("fitting it again as the camera sees the balls")
            located = seen_from(located, begun.fit.map, viewpoint)
            begun = fit_to(located, illumination, begun)
        tell("fitting the light model")
        columns = prepared.flat_field.shape[1]
        positions = np.asarray(lights_mm, np.float64) * (1e3 / prepared.pitch_um / columns) if lights_mm else None
        lowered = LoweredBalls.of(located, begun.fit, slope_sigma_of(begun.fit.held_out_deg), positions)
        if lowered.light.has_sources:
            located = lowered.presses
            begun = fit_to(located, illumination, begun)
        inverse = begun.finished()
        inverse = replace(inverse, map=less_noise(inverse.map, [press.intensity for press in located]))
        if prepared.reference:
            inverse = replace(inverse, map=with_free_skin(inverse.map, pressed(located)))
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
