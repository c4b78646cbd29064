"""The workstation's calibration: from press frames to the models that turn intensity into slope."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Final, Literal

import numpy as np

from device.balls.sphere import BallSamples, gather_samples
from device.balls.viewpoint import Viewpoint
from device.calibration.fit import InverseFit
from device.errors import CalibrationError
from device.imaging.flat_field import LinearFrame, flat_field_correct
from device.inverse_map.illumination import IlluminationMap
from device.inverse_map.noise_bias import less_noise
from device.inverse_map.skin_at_rest import SkinAtRest
from device.surface.fields import Float32Array
from host_sync.calibration.assessment import Assessment, assess, with_reference
from host_sync.calibration.ball_choice import Centres, fit_to, fit_to_best_balls
from host_sync.calibration.balls import (
    PressFrame,
    UsedPress,
    apply_fit,
    check_distinct,
    check_sizes,
)
from host_sync.calibration.consistency import check_reference
from host_sync.calibration.free_skin import with_free_skin
from host_sync.calibration.lamp_drift import PressLevels
from host_sync.calibration.located_presses import flat_field_of, locate_all
from host_sync.calibration.lowered_balls import LoweredBalls
from host_sync.calibration.nearby_camera import seen_from
from host_sync.calibration.press_drift import drift_note, fit_without_drift, without_drift
from host_sync.calibration.radii import without_contradiction
from host_sync.calibration.stray_light import with_stray_light
from host_sync.calibration.training_press import TrainingPress, training_presses
from host_sync.denoising.bounded_shrinkage import DetailShrinkage, learn_shrinkage
from host_sync.denoising.null_colour import NullColour, learn_null_colour
from host_sync.denoising.slope_noise import measure_slope_noise
from host_sync.frame_checks.frame_model import FrameModel
from host_sync.johnson2009.held_out import held_out_paper_deg
from host_sync.johnson2009.model import PaperModel, fit_paper_model
from host_sync.light.fit import FittedLight
from host_sync.light.model import Position
from host_sync.light.presses import confirmed_fraction, held_out_readers
from host_sync.lights.light_groups import LightGroups
from host_sync.results.record import SlopeNoise
from host_sync.uncertainty.elevation import ElevationCorrection, elevation_correction
from host_sync.uncertainty.slope_error import SlopeError, measure_slope_error

Method = Literal["direct", "paper"]
METHODS: Final[tuple[Method, ...]] = ("direct", "paper")
OPEN_CHOICE_DEG: Final = 2.0
"""From this held-out error of the default on, the paper's method is tried beside it without being asked for. It is
worse on every set of `docs/paper.md`, real or simulated."""


NO_HELD_OUT_DEG: Final = 5.0
"""Error of the inverse map's slopes that is assumed where too few balls were given to hold one out."""


def slope_sigma_of(held_out_deg: float | None) -> float:
    """Return the standard uncertainty of a slope component for a mean angular error, degrees; None if not known."""
    known_deg = held_out_deg if held_out_deg is not None and np.isfinite(held_out_deg) else NO_HELD_OUT_DEG
    return float(np.tan(np.radians(known_deg)) / np.sqrt(np.pi / 2.0))


def is_open(direct_deg: float) -> bool:
    """Whether the paper's method may be the better one, by the default's held-out error (degrees)."""
    return direct_deg >= OPEN_CHOICE_DEG


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """Everything that reconstruction needs, and what the report tells.

    calibration_id : digest of the models and the reference
    flat_field : float32 array of shape (H, W, 3), what frames are divided by
    has_reference : False when the divisor is a stand-in fitted to the frames
    pitch_um : distance of neighbouring pixels on the skin, µm; measured where a ball grid's spacing is known
    centres : where the balls' centres came from before they were refined
    inverse : the position-aware inverse map and its held-out errors
    paper : the paper's model, None where it was neither asked for nor likely to be better
    held_out_deg : mean angular error on held-out balls by method, of those that were fitted
    assessment : what the calibration is worth: the scale's ±, coverage, pass or fail
    frame_model : what its frames have in common, by which a foreign frame is refused
    light : the forward model of the sensor's light, by which slopes are refined
    elevation : at which balls showed each slope, and what another one changes in slopes by the inverse map
    shrinkage : how pixel noise is taken out of frames; None where it cannot be told from detail
    slope_noise : what is left of it in slopes, None without a shrinkage
    null_colour : what takes part of it off slopes of raw frames; None where nothing tells it from detail
    viewpoint : where the camera looks from, None where it is not known
    press_levels : light of untouched skin in the presses, by which the lamps' drift is told; None where none shows it
    skin_at_rest : how the light of untouched skin differs from frame to frame; None without a reference
    lights : of a sensor with another number of lights than three, whose first group of three all else here reads
    beside : calibrations of the other groups
    """

    calibration_id: str
    flat_field: Float32Array
    has_reference: bool
    pitch_um: float
    presses: tuple[TrainingPress, ...]
    centres: Centres
    inverse: InverseFit
    paper: PaperModel | None
    slope_error: SlopeError
    held_out_deg: dict[Method, float]
    assessment: Assessment
    frame_model: FrameModel
    light: FittedLight
    elevation: ElevationCorrection
    shrinkage: DetailShrinkage | None = None
    slope_noise: SlopeNoise | None = None
    viewpoint: Viewpoint | None = None
    press_levels: PressLevels | None = None
    null_colour: NullColour | None = None
    skin_at_rest: SkinAtRest | None = None
    lights: LightGroups | None = None
    beside: tuple[Calibration, ...] = ()

    @property
    def pixel_pitch_sigma_um(self) -> float | None:
        """Standard uncertainty of `pitch_um`, None when it was not measured."""
        return self.assessment.scale.pixel_pitch_sigma_um

    @property
    def prior_sigma(self) -> float:
        """Standard uncertainty of the inverse map's slopes."""
        return slope_sigma_of(self.held_out_deg["direct"])

    @property
    def preferred(self) -> Method:
        """The method that held-out balls prefer."""
        direct = self.held_out_deg["direct"]
        return "paper" if is_open(direct) and self.held_out_deg["paper"] < direct else "direct"

    @property
    def paper_model(self) -> PaperModel:
        """The paper's model.

        Raises
        ------
        CalibrationError
            It was not fitted.
        """
        if self.paper is None:
            raise CalibrationError(
                "the calibration holds no model of the paper's method: make it with `retrosync calibrate --paper`, in "
                "Python with paper=True"
            )
        return self.paper


def calibrate(
    presses: Sequence[PressFrame],
    reference: LinearFrame | None,
    pitch_um: float,
    *,
    others: Sequence[LinearFrame] = (),
    tell: Callable[[str], None] = lambda _: None,
    paper: bool = False,
    lamps_mm: Sequence[Position] = (),
    pupil_height_mm: float | None = None,
) -> Calibration:
    """The calibration of one gel and set of lights.

    reference : frame of the untouched skin; None fits a stand-in to the presses and `others`
    pitch_um : as stated; where a press shows a grid of known spacing, the pitch that it measures is used instead
    tell : is given a few words as each step begins
    paper : fit the paper's model also where it has no prospect of a smaller held-out error
    lamps_mm : places of the sources by channel, see `Position`; empty where it is not known
    pupil_height_mm : the camera's height over untouched skin, see `Viewpoint`; None where it is not known

    Raises
    ------
    CalibrationError
        No press, one twice, too few balls, contradictory radii, a grossly wrong pitch, or wrong held-out balls.
    CalibrationMismatch
        Frames of different sizes, channel orders, lights or gels.
    """
    if not presses:
        raise CalibrationError("there is no calibration press: press a ball of known radius into the gel")
    check_sizes(presses, reference)
    check_distinct(presses)
    if reference is not None:
        check_reference(reference)
    tell("flat-field correction")
    flat_field = flat_field_of([*(press.frame for press in presses), *others], reference)
    tell("finding balls")
    located, pitch = locate_all(presses, flat_field, pitch_um, reference)
    pitch_um = pitch.pitch_um if pitch else pitch_um
    frame_model = FrameModel.of(reference, flat_field, [(press.intensity, press.balls) for press in located])
    tell("measuring the frames' noise")
    at_rest = SkinAtRest.of([(press.intensity, press.balls) for press in located], flat_field) if reference else None
    shrinkage = _learn_shrinkage(located, reference, flat_field)
    located = _without_noise(located, shrinkage)
    tell("fitting the position-aware inverse map")
    light = IlluminationMap.of(flat_field) if reference else None
    begun, located, centres = fit_to_best_balls(presses, located, light)
    begun, drifts = fit_without_drift(located, begun, light) if light else (begun, None)
    if drifts is not None:
        located = without_drift(located, drifts)
    located, begun = without_contradiction(located, begun, light)
    viewpoint = None
    # A grid's pitch is that at the balls' tops, as the camera sees it.
    if pupil_height_mm is not None and pitch is None:
        viewpoint = Viewpoint.over_middle(pupil_height_mm, pitch_um, located[0].intensity.shape)
        tell("fitting it again as the camera sees the balls")
        located = seen_from(located, begun.fit.map, viewpoint)
        begun = fit_to(located, light, begun)
    tell("fitting the light model")
    positions = np.asarray(lamps_mm, np.float64) * (1e3 / pitch_um / flat_field.shape[1]) if lamps_mm else None
    lowered = LoweredBalls.of(located, begun.fit, slope_sigma_of(begun.fit.held_out_deg), positions)
    if lowered.light.has_sources:
        located = lowered.presses
        begun = fit_to(located, light, begun)
    inverse = begun.finished()
    inverse = replace(inverse, map=less_noise(inverse.map, [press.intensity for press in located]))
    if reference:
        pressed = [(press.intensity, press.balls) for press in located]
        inverse = replace(inverse, map=with_free_skin(inverse.map, pressed))
    used = apply_fit(located, inverse)
    kept = [(press.intensity, press.balls) for press in used]
    training = gather_samples(kept)
    assessment = assess(presses, used, training, inverse, pitch, pitch_um)
    if drifts is not None:
        assessment = replace(assessment, notes=(*assessment.notes, drift_note(drifts)))
    if reference and at_rest is not None:
        assessment = with_reference(assessment, at_rest, flat_field_correct(reference, flat_field))
    held_out: dict[Method, float] = {"direct": float("nan") if inverse.held_out_deg is None else inverse.held_out_deg}
    model = None
    if paper or is_open(held_out["direct"]):
        tell("building reflectance maps and the lookup table")
        model = fit_paper_model(training)
        held_out["paper"] = held_out_paper_deg(kept)
    tell("measuring the slope error")
    prior_sigma = slope_sigma_of(inverse.held_out_deg)
    seen = elevation_correction(kept, training, inverse.map)
    elevation = lowered.elevation(seen)
    confirmed = confirmed_fraction(lowered.light, inverse.replicas or (inverse.map,), kept, elevation, prior_sigma)
    fitted = replace(lowered.light, confirmed=confirmed)
    over_cells = held_out_readers(fitted, inverse.map, kept, elevation, prior_sigma) if confirmed else None
    left = seen.shared(fitted.model.uncertain_fraction(prior_sigma)) if fitted.has_sources else seen
    error = measure_slope_error(kept, training, inverse, left, over_cells)
    images = [image for image, _ in kept] if reference else []
    levels = with_stray_light(PressLevels.of(images, inverse.map), images, flat_field, inverse.map)
    null_colour = None if shrinkage is None else learn_null_colour(training, inverse.map, shrinkage.noise)
    noise = _slope_noise(shrinkage, inverse, training, null_colour, demosaiced=presses[0].frame.demosaiced)
    digest = _digest(
        inverse, flat_field, pitch_um, shrinkage, fitted, levels, viewpoint, noise, null_colour, at_rest,
        (prior_sigma, confirmed, elevation.apex_px, elevation.radius_px, elevation.nearness_per_px),
    )  # fmt: skip
    return Calibration(
        calibration_id=digest,
        flat_field=flat_field,
        has_reference=reference is not None,
        pitch_um=pitch_um,
        presses=training_presses(used),
        centres=centres,
        inverse=inverse,
        paper=model,
        slope_error=error,
        held_out_deg=held_out,
        assessment=assessment,
        frame_model=frame_model,
        light=fitted,
        elevation=elevation,
        shrinkage=shrinkage,
        slope_noise=noise,
        viewpoint=viewpoint,
        press_levels=levels,
        null_colour=null_colour,
        skin_at_rest=at_rest,
    )


def _learn_shrinkage(
    located: Sequence[UsedPress], reference: LinearFrame | None, flat_field: Float32Array
) -> DetailShrinkage | None:
    """How frames are shrunk, from the presses and untouched skin: the reference, or most of every press."""
    pressed = [(press.intensity, press.balls) for press in located]
    at_rest = [flat_field_correct(reference, flat_field)] if reference else [image for image, _ in pressed]
    return learn_shrinkage(pressed, gather_samples(pressed), [image.values for image in at_rest])


def _slope_noise(
    shrinkage: DetailShrinkage | None,
    inverse: InverseFit,
    training: BallSamples,
    null_colour: NullColour | None,
    *,
    demosaiced: bool,
) -> SlopeNoise | None:
    if shrinkage is None:
        return None
    noise, by = shrinkage.noise, shrinkage.shrinkage
    return measure_slope_noise(noise, by, inverse.map, training, null_colour, demosaiced=demosaiced)


def _without_noise(located: Sequence[UsedPress], shrinkage: DetailShrinkage | None) -> Sequence[UsedPress]:
    """The presses with their noise shrunk, as scans are read."""
    if shrinkage is None:
        return located
    return [replace(press, intensity=shrinkage.shrunk(press.intensity)) for press in located]


def _digest(
    inverse: InverseFit,
    flat_field: Float32Array,
    pitch_um: float,
    shrinkage: DetailShrinkage | None = None,
    light: FittedLight | None = None,
    levels: PressLevels | None = None,
    viewpoint: Viewpoint | None = None,
    noise: SlopeNoise | None = None,
    null_colour: NullColour | None = None,
    at_rest: SkinAtRest | None = None,
    priors: Sequence[float] = (),
) -> str:
    """Twelve hexadecimal digits that change when the calibration does."""
    digest = hashlib.sha256(np.array([pitch_um, *priors]).tobytes())
    for _, array in sorted(inverse.map.arrays().items()):
        digest.update(np.ascontiguousarray(array).tobytes())
    digest.update(np.ascontiguousarray(flat_field).tobytes())
    if shrinkage is not None:
        digest.update(shrinkage.shrinkage.whitening.tobytes() + shrinkage.shrinkage.threshold.tobytes())
    for model in (light.model, *light.folds) if light else ():
        for field in fields(model):
            digest.update(np.asarray(getattr(model, field.name), np.float64).tobytes())
    if levels is not None:
        told = [*levels.mean, levels.sigma, *([] if levels.stray_sigma is None else [levels.stray_sigma])]
        digest.update(np.array(told).tobytes())
    if viewpoint is not None:
        digest.update(np.array([viewpoint.column, viewpoint.row, viewpoint.height_px]).tobytes())
    if noise is not None and noise.raw_blur_px > 0.0:
        digest.update(np.array([noise.blur_px, noise.raw_blur_px]).tobytes())
    if null_colour is not None:
        digest.update(
            null_colour.channels.tobytes() + null_colour.slopes.tobytes() + np.float64(null_colour.limit).tobytes()
        )
    for member in fields(at_rest) if at_rest else ():
        digest.update(np.asarray(getattr(at_rest, member.name)).tobytes())
    return digest.hexdigest()[:12]
