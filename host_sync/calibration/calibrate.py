"""The workstation's calibration: from press frames to the models that turn intensity into slope."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal

from device.balls.sphere import Viewpoint
from device.calibration.fit import InverseFit
from device.errors import CalibrationError
from device.imaging.flat_field import LinearFrame, flat_field_correct
from device.inverse_map.model import slope_sigma_of
from device.inverse_map.skin_at_rest import SkinAtRest
from device.surface import Float32Array
from host_sync.calibration.assessment import Assessment, assess, light_notes, with_reference
from host_sync.calibration.balls import PressFrame
from host_sync.calibration.preparation import PreparedPresses, TrainingPress, training_presses
from host_sync.calibration.radii import Centres
from host_sync.calibration.slope_models import SlopeModels
from host_sync.denoising.bounded_shrinkage import DetailShrinkage
from host_sync.denoising.frame_noise import NullColour, learn_null_colour
from host_sync.denoising.slope_noise import measure_slope_noise
from host_sync.frame_checks.frame_model import FrameModel
from host_sync.johnson2009.model import PaperModel, fit_paper_model, held_out_paper_deg
from host_sync.light.fit import FittedLight
from host_sync.light.model import Position
from host_sync.light_groups import LightGroups
from host_sync.results.record import SlopeNoise
from host_sync.results.typed_members import as_members
from host_sync.uncertainty.elevation import ElevationCorrection
from host_sync.uncertainty.slope_error import SlopeError

Method = Literal["direct", "paper"]
METHODS: Final[tuple[Method, ...]] = ("direct", "paper")
OPEN_CHOICE_DEG: Final = 2.0
"""From this held-out error of the default on, the paper's method is tried beside it without being asked for. It is
worse on every set of `docs/paper.md`, real or simulated."""


def should_try_paper_method(direct_deg: float) -> bool:
    """Return True where the paper's method may be the better one, by the default's held-out error (degrees)."""
    return direct_deg >= OPEN_CHOICE_DEG


@dataclass(frozen=True, slots=True, eq=False)
class Denoising:
    """Models by which noise is removed from frames.

    shrinkage : of pixels
    slope_noise : what is left of noise in slopes
    null_colour : change of colour that carries noise alone in raw frames; None where no colour does
    """

    shrinkage: DetailShrinkage
    slope_noise: SlopeNoise
    null_colour: NullColour | None


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """Everything that reconstruction needs, and that the report shows.

    calibration_id : digest of the models and the reference
    flat_field : float32 array of shape (H, W, 3), what frames are divided by
    has_reference : False when the flat field is a stand-in fitted to the frames
    pitch_um : distance of neighbouring pixels on the skin, µm; measured where a ball grid's spacing is known
    centres : where the balls' centres came from before they were refined
    inverse : the position-aware inverse map and its held-out errors
    paper : the paper's model, None where it was neither asked for nor likely to be better
    held_out_deg : mean angular error on held-out balls by method, of those that were fitted
    assessment : what the calibration is worth: the scale's ±, coverage, pass or fail
    frame_model : what its frames have in common, by which a foreign frame is refused
    light : the forward model of the sensor's light, by which slopes are refined
    elevation : at which balls showed each slope, and what another one changes in slopes by the inverse map
    denoising : of frames; None where noise and detail cannot be separated
    viewpoint : where the camera looks from, None where it is not known
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
    denoising: Denoising | None = None
    viewpoint: Viewpoint | None = None
    skin_at_rest: SkinAtRest | None = None
    lights: LightGroups | None = None
    beside: tuple[Calibration, ...] = ()

    @property
    def pixel_pitch_sigma_um(self) -> float | None:
        """Standard uncertainty of `pitch_um`, None when it was not measured."""
        return self.assessment.scale.pixel_pitch_sigma_um

    @property
    def shrinkage(self) -> DetailShrinkage | None:
        """Shrinkage of pixels' noise; None where noise and detail cannot be separated."""
        return None if self.denoising is None else self.denoising.shrinkage

    @property
    def slope_noise(self) -> SlopeNoise | None:
        """Noise that the shrinkage leaves in slopes; None without one."""
        return None if self.denoising is None else self.denoising.slope_noise

    @property
    def null_colour(self) -> NullColour | None:
        """Change of colour that carries noise alone in raw frames; None where no colour does."""
        return None if self.denoising is None else self.denoising.null_colour

    @property
    def prior_sigma(self) -> float:
        """Standard uncertainty of the inverse map's slopes."""
        return slope_sigma_of(self.held_out_deg["direct"])

    @property
    def preferred(self) -> Method:
        """The method that held-out balls prefer."""
        direct = self.held_out_deg["direct"]
        return "paper" if should_try_paper_method(direct) and self.held_out_deg["paper"] < direct else "direct"

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
    report_progress: Callable[[str], None] = lambda _: None,
    paper: bool = False,
    lights_mm: Sequence[Position] = (),
    pupil_height_mm: float | None = None,
) -> Calibration:
    """Return the calibration of one gel and set of lights.

    reference : frame of the untouched skin; None fits a stand-in to the presses and `others`
    pitch_um : as stated; where a press shows a grid of known spacing, the pitch that it measures is used instead
    report_progress : is given a few words as each step begins
    paper : fit the paper's model also where it has no prospect of a smaller held-out error
    lights_mm : places of the sources by channel, see `Position`; empty where it is not known
    pupil_height_mm : the camera's height over untouched skin, see `Viewpoint`; None where it is not known

    Raises
    ------
    CalibrationError
        No press, one twice, too few balls, contradictory radii, a grossly wrong pitch, or wrong held-out balls.
    CalibrationMismatch
        Frames of different sizes, channel orders, lights or gels.
    """
    prepared = PreparedPresses.of(presses, reference, pitch_um, others, report_progress)
    models = SlopeModels.of(prepared, lights_mm, pupil_height_mm, report_progress)
    assessment = _assessment(prepared, models)
    held_out_deg, paper_model = _paper(models, report_progress, wanted=paper)
    report_progress("measuring the slope error")
    light, elevation, slope_error = models.held_out()
    found = Calibration(
        calibration_id="",
        flat_field=prepared.flat_field,
        has_reference=reference is not None,
        pitch_um=prepared.pitch_um,
        presses=training_presses(models.used),
        centres=models.centres,
        inverse=models.inverse,
        paper=paper_model,
        slope_error=slope_error,
        held_out_deg=held_out_deg,
        assessment=assessment,
        frame_model=prepared.frame_model,
        light=light,
        elevation=elevation,
        denoising=_denoising(prepared, models),
        viewpoint=models.viewpoint,
        skin_at_rest=prepared.at_rest and replace(prepared.at_rest, removes_light=models.removes_light),
    )
    return identified(found)


def identified(calibration: Calibration) -> Calibration:
    """Return a calibration with the id that follows from everything in it."""
    digest = hashlib.sha256()
    for name, data in sorted(as_members(replace(calibration, calibration_id="")).items()):
        digest.update(name.encode() + data)
    return replace(calibration, calibration_id=digest.hexdigest()[:12])


def _assessment(prepared: PreparedPresses, models: SlopeModels) -> Assessment:
    """Return what the calibration is worth, the reference judged as a scan; errors as for `assess`."""
    found = assess(
        prepared.frames, models.used, models.training, models.inverse, prepared.measured_pitch, prepared.pitch_um
    )
    found = replace(found, notes=(*found.notes, *(light_notes(prepared.lights) if models.removes_light else ())))
    if prepared.reference is None or prepared.at_rest is None:
        return found
    return with_reference(found, prepared.at_rest, flat_field_correct(prepared.reference, prepared.flat_field))


def _paper(
    models: SlopeModels, report_progress: Callable[[str], None], *, wanted: bool
) -> tuple[dict[Method, float], PaperModel | None]:
    """Return held-out errors by method, and the paper's model where it is wanted or may be the better one."""
    direct_deg = models.inverse.held_out_deg
    held_out: dict[Method, float] = {"direct": float("nan") if direct_deg is None else direct_deg}
    if not wanted and not should_try_paper_method(held_out["direct"]):
        return held_out, None
    report_progress("building reflectance maps and the lookup table")
    found = fit_paper_model(models.training)
    held_out["paper"] = held_out_paper_deg(models.pressed)
    return held_out, found


def _denoising(prepared: PreparedPresses, models: SlopeModels) -> Denoising | None:
    """Return how noise is removed from frames; None where noise and detail cannot be separated."""
    shrinkage, inverse_map, training = prepared.shrinkage, models.inverse.map, models.training
    if shrinkage is None:
        return None
    colour = learn_null_colour(training, inverse_map, shrinkage.noise)
    demosaiced = prepared.frames[0].frame.demosaiced
    noise = measure_slope_noise(
        shrinkage.noise, shrinkage.shrinkage, inverse_map, training, colour, demosaiced=demosaiced
    )
    return Denoising(shrinkage, noise, colour)
