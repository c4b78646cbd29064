"""Measures a result by a recipe: on the height map, then on each Monte Carlo sample of it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np

from device.surface import Float32Array, Float64Array, HeightMap
from host_sync.errors import MeasurementError
from host_sync.iso25178.areal_parameters import ParameterKind
from host_sync.iso25178.power_spectrum import PowerSpectrum, RadialSpectrum
from host_sync.measurement.foreign_file import read_foreign
from host_sync.measurement.geometry import SkinPlaces, painted, reaches_beyond, share_at, without
from host_sync.measurement.height_samples import HeightSamples, SampledSurface
from host_sync.measurement.levelling import Levelling, LevelSpread
from host_sync.measurement.measurands import (
    AngleMeasurand,
    CircleMeasurand,
    DistanceMeasurand,
    FailedMeasurand,
    Measurand,
    RadiusMeasurand,
    StepMeasurand,
    VolumeMeasurand,
)
from host_sync.measurement.measurement import MeasuredProfile, MeasuredSpectrum, MeasuredStep, Measurement
from host_sync.measurement.parameter_measurands import ArealMeasurand, ProfileMeasurand
from host_sync.measurement.quantity import (
    DIRECTION,
    NO_PITCH_SIGMA,
    NOISE_FRACTION,
    NOISE_WARNING,
    Quantity,
    bias_taken_off,
    judged,
    uncertainty_of,
    uncertainty_of_uncertainty,
    unmet,
)
from host_sync.measurement.recipe import Recipe
from host_sync.profile.profile_line import Profile
from host_sync.profile.step_height import lines_um, used_samples
from host_sync.results.doubts import FOREIGN_METHOD, doubts_at
from host_sync.results.files import SAMPLES_FILE, SLOPE_SIGMA_FILE
from host_sync.results.reader import ResultSurface, read_result

NO_SHAPE_SIGMA: Final = (
    "± not stated: without an L-filter waviness dominates, which slopes determine least: set l_filter_um"
)

NO_LENGTH_SIGMA: Final = "± not known, because that of the pixel pitch is not: set scale.pixel_pitch_share"

BEYOND: Final = "reaches beyond the field: only the part inside is measured"

ROUNDING: Final = 1e-6
"""A spread of so small a share of a number is that of float32."""

MEASURANDS: Final[Mapping[str, tuple[str, Callable[..., Measurand]]]] = {
    "step": ("height", StepMeasurand),
    "distance": ("in space", DistanceMeasurand),
    "angle": ("angle", AngleMeasurand),
    "radius": ("radius", RadiusMeasurand),
    "volume": ("void volume", VolumeMeasurand),
    "circle": ("diameter", CircleMeasurand),
}
"""Of a recipe's tables: the number that has the reason where one is not found, and what measures it."""

Numbers = Mapping[str, float]
Bias = tuple[float, float]
"""Noise bias of a number, and its standard uncertainty."""


@dataclass(frozen=True, slots=True, eq=False)
class _Evaluation:
    """Results on one surface.

    numbers : of each measurand
    traces : the profiles, then the spectral densities if the recipe has a spectrum; float64 arrays of shape (N,)
    """

    surface: HeightMap
    numbers: Sequence[Numbers]
    traces: Sequence[Float64Array]


class _MeasurementPlan:
    """All measurands of a recipe: parameters of surface and profiles on one height map, all others on another.

    Parameters
    ----------
    surface : with the detail that roughness is measured on
    smooth : height map with the detail that steps and radii are measured on
    places : of the pixels
    """

    def __init__(self, surface: ResultSurface, smooth: HeightMap, recipe: Recipe, places: SkinPlaces) -> None:
        height = surface.height
        self.areal = ArealMeasurand(recipe, height, places, surface.extrapolated)
        made = [_made(table, "profile", ProfileMeasurand, height) for table in recipe.profile]
        self.profiles = [one for one in made if isinstance(one, ProfileMeasurand)]
        others = [
            _made(table, label, kind, smooth, places)
            for name, (label, kind) in MEASURANDS.items()
            for table in getattr(recipe, name)
        ]
        failed = [one for one in made if isinstance(one, FailedMeasurand)]
        self.others: list[Measurand] = [*self.profiles, *others, *failed]
        self.failed = [one for one in self.others if isinstance(one, FailedMeasurand)]
        shape = (height.z_um.shape[0], height.z_um.shape[1])
        self.doubts = [self._doubts(surface, one, shape) for one in self.measurands]
        scale = surface.record.height_scale
        self.pitch_is_known = (scale.pixel_pitch_share or recipe.scale.pixel_pitch_share) is not None
        self._spectrum: RadialSpectrum | None = None
        if recipe.spectrum:
            self._spectrum = RadialSpectrum(self.areal.valid, height.pitch_um)

    def _doubts(self, surface: ResultSurface, one: Measurand, shape: tuple[int, int]) -> tuple[str, ...]:
        """Return the result's doubts that concern a measurand, a sentence each."""
        share = share_at(surface.extrapolated, one.places_px) if len(one.places_px) else None
        if one is self.areal and share is not None:
            share = 0.0  # it states its own fraction, and what was done with it
        words = tuple(doubt.sentence for doubt in doubts_at(surface.doubts, one.places_px, shape, share))
        return (*words, BEYOND) if reaches_beyond(shape, one.places_px) else words

    @property
    def measurands(self) -> list[Measurand]:
        return [self.areal, *self.others]

    def doubts_of(self, one: Measurand) -> tuple[str, ...]:
        """Return the doubts of one of the measurands."""
        return self.doubts[self.measurands.index(one)]

    def rough(self, z_um: Float32Array) -> tuple[Numbers, ...]:
        """Return the parameters of surface and profiles of a height map of shape (H, W)."""
        areal = self.areal.parameters(self.areal.surface(z_um).z_um)
        return (areal, *(one.values(z_um) for one in self.profiles))

    def evaluate(self, z_um: Float32Array, smooth_um: Float32Array, stretch: float = 1.0) -> _Evaluation:
        """Return all measurands on height maps of shape (H, W), with lateral lengths scaled by `stretch`.

        smooth_um : for steps, radii, distances, angles and volumes

        Raises
        ------
        MeasurementError
            A measurand is not found on it.
        """
        limited = self.areal.surface(z_um)
        numbers = [self.areal.parameters(limited.z_um), *(_numbers(one, z_um) for one in self.profiles)]
        numbers += [_numbers(one, smooth_um) for one in self.others[len(self.profiles) :]]
        traces = [one.trace(z_um).z_um for one in self.profiles]
        if self._spectrum is not None:
            traces.append(self._spectrum.of(limited.z_um).density_um3)
        kinds = [one.kinds() for one in self.measurands]
        return _Evaluation(limited, [_stretched(*pair, stretch) for pair in zip(numbers, kinds, strict=True)], traces)

    def spectrum(self, found: _Evaluation) -> PowerSpectrum | None:
        """Return the spectrum, if the recipe has one."""
        bands = self._spectrum
        return None if bands is None else PowerSpectrum(bands.per_um, bands.width_per_um, found.traces[-1])


Made = TypeVar("Made", bound=Measurand)


def _made(
    table: Any, label: str, kind: Callable[..., Made], *surface: HeightMap | SkinPlaces
) -> Made | FailedMeasurand:
    """Return the measurand of a table, or what says why the result does not show it."""
    try:
        return kind(table, *surface)
    except MeasurementError as error:
        return FailedMeasurand(table.name, label, str(error))


def _numbers(one: Measurand, z_um: Float32Array) -> Numbers:
    """Its values; not a number where a sample does not show it."""
    try:
        return one.values(z_um)
    except MeasurementError:
        return dict.fromkeys(one.kinds(), float("nan"))


def measure_result(
    folder: Path, recipe: Recipe, report_progress: Callable[[str], None] = lambda _: None, *, samples: bool = True
) -> Measurement:
    """Return the measurement of a result folder, or of another instrument's file.

    samples : whether to compute uncertainties; without them a measurement takes a fraction of the time

    Raises
    ------
    UnreadableResult
        The result is damaged.
    MeasurementError
        A measurand of the recipe is not found on it.
    """
    report_progress(f"{folder.name}: reading")
    surface = read_foreign(folder) if folder.is_file() else read_result(folder)
    return measure(surface if samples else replace(surface, samples_um=None), recipe, report_progress)


def measure(
    surface: ResultSurface, recipe: Recipe, report_progress: Callable[[str], None] = lambda _: None
) -> Measurement:
    """Return the measurement of a surface; errors as for `measure_result`."""
    smooth = surface.with_detail(recipe.detail or "shrunk")
    surface = surface.with_detail(recipe.detail or "raw")
    if recipe.mask:
        left_out = painted(recipe.mask, (surface.record.rows, surface.record.columns), surface.height.pitch_um)
        surface, smooth = (replace(one, height=without(one.height, left_out)) for one in (surface, smooth))
    level, places = Levelling(recipe.level, smooth) if recipe.level else None, SkinPlaces.of(surface.record)
    if level is not None:
        places = places.levelled(*level.plane(smooth.height.z_um))
        surface, smooth = (replace(one, height=_levelled(one.height, level)) for one in (surface, smooth))
    plan = _MeasurementPlan(surface, smooth.height, recipe, places)
    found = plan.evaluate(surface.height.z_um, smooth.height.z_um)
    samples = HeightSamples(surface, recipe.scale)
    raised = _raised(plan, found, samples.noisier())
    drawn: list[Sequence[Numbers]] = []
    squares = [np.zeros_like(trace) for trace in found.traces]
    spread = LevelSpread(smooth.height.z_um)
    for number, (allowed, smoother) in enumerate(_drawn(samples, surface, smooth, recipe), start=1):
        report_progress(f"{surface.folder.name}: sample {number} of {len(samples)}")
        try:
            heights = (allowed.z_um, smoother.z_um)
            rough_um, smooth_um = heights if level is None else (level.apply(z_um) for z_um in heights)
            sample = plan.evaluate(rough_um, smooth_um, allowed.stretch)
        except MeasurementError:
            continue  # a sample without the measurand gives no value; each quantity states its number of samples
        drawn.append(sample.numbers)
        spread.add(smoother.z_um, smooth_um)
        for square, trace, first in zip(squares, sample.traces, found.traces, strict=True):
            square += (trace - first) ** 2
    sigmas = [np.sqrt(square / len(drawn)) if drawn else None for square in squares]
    spectrum = plan.spectrum(found)
    numbers = _quantities(plan, found.numbers, drawn, recipe.coverage_factor, raised)
    quantities = judged(numbers, recipe.tolerance, pitch_is_known=plan.pitch_is_known)
    return Measurement(
        folder=surface.folder,
        record=surface.record,
        recipe=recipe,
        quantities=quantities,
        notes=(
            *plan.areal.notes(),
            *((level.words + spread.words(len(drawn)),) if level else ()),
            *_notes(surface, recipe, len(samples)),
        ),
        height=smooth.height,
        surface=found.surface,
        sigma_um=surface.sigma_um,
        profiles=tuple(
            MeasuredProfile(one.name, one.line, Profile(trace, surface.height.pitch_um), sigma, plan.doubts_of(one))
            for one, trace, sigma in zip(plan.profiles, found.traces, sigmas, strict=False)
        ),
        spectrum=MeasuredSpectrum(spectrum, sigmas[-1]) if spectrum else None,
        doubts=surface.doubts,
        steps=tuple(_step(one, plan.doubts_of(one)) for one in plan.others if isinstance(one, StepMeasurand)),
        failed=(*(one.name for one in plan.failed), *unmet(quantities, recipe.tolerance)),
    )


def _levelled(height: HeightMap, level: Levelling) -> HeightMap:
    return HeightMap(level.apply(height.z_um), height.pitch_um)


def _step(one: StepMeasurand, doubts: tuple[str, ...]) -> MeasuredStep:
    base_um, top_um = lines_um(one.profile, one.edges)
    used = used_samples(one.profile, one.edges)
    return MeasuredStep(one.name, one.line, one.profile, one.edges.places_um, base_um, top_um, used, doubts)


def _drawn(
    samples: HeightSamples, surface: ResultSurface, smooth: ResultSurface, recipe: Recipe
) -> Iterator[tuple[SampledSurface, SampledSurface]]:
    """Yield every sample on the surface for roughness and on that for steps and radii, which may be one."""
    if smooth.detail == surface.detail:
        return ((drawn, drawn) for drawn in samples.surfaces())
    return zip(samples.surfaces(), HeightSamples(smooth, recipe.scale).surfaces(), strict=True)


def _raised(
    plan: _MeasurementPlan, found: _Evaluation, noisier: Iterable[Float32Array]
) -> Sequence[Mapping[str, Bias]]:
    """By how much pixel noise has raised parameters of surface and profiles that measure an amplitude, and its ±."""
    looks = [plan.rough(z_um) for z_um in noisier]
    if not looks:
        return ()
    raised = []
    for index, (numbers, measurand) in enumerate(zip(found.numbers[: len(looks[0])], plan.measurands, strict=False)):
        biases = {}
        for name, kind in measurand.kinds().items():
            steps = np.array([look[index][name] for look in looks]) - numbers[name]
            if kind.is_amplitude and steps.mean() > 0.0:
                biases[name] = bias_taken_off(numbers[name], steps, kind.noise_law)
        raised.append(biases)
    return raised


def _stretched(numbers: Numbers, kinds: Mapping[str, ParameterKind], stretch: float) -> Numbers:
    return {name: float(numbers[name]) * stretch**kind.stretch_power for name, kind in kinds.items()}


def _quantities(
    plan: _MeasurementPlan,
    found: Sequence[Numbers],
    drawn: Sequence[Sequence[Numbers]],
    factor: int,
    noise: Sequence[Mapping[str, Bias]] = (),
) -> Iterable[Quantity]:
    for index, (measurand, numbers) in enumerate(zip(plan.measurands, found, strict=True)):
        warnings, definition = measurand.warnings(), measurand.definition_sigmas()
        for name, kind in measurand.kinds().items():
            value = numbers[name]
            others = np.array([sample[index][name] for sample in drawn])
            known = uncertainty_of(value, others, is_direction=name == DIRECTION, law=kind.noise_law)
            if known and known[0] <= ROUNDING * abs(value):
                known = None  # the samples do not vary it: a lateral length whose pitch has no uncertainty
            words = (*warnings.get("", ()), *warnings.get(name, ()))
            if kind.stretch_power and not plan.pitch_is_known and np.isfinite(value):
                words += (NO_PITCH_SIGMA if known else NO_LENGTH_SIGMA,)
            words += plan.doubts[index]
            if known and name in definition:
                own = float(np.hypot(known[0], definition[name]))
                known = (own, *known[1:]) if np.isfinite(own) else None
            if known and measurand is plan.areal and name in plan.areal.without_sigma:
                known, words = None, (*words, NO_SHAPE_SIGMA)
            taken, sigma = noise[index].get(name, (None, 0.0)) if index < len(noise) else (None, 0.0)
            if known and taken is not None:
                value -= taken
                # Its spread over the samples, and beside it the uncertainty of the noise.
                spread = float(np.sqrt(max(known[0] ** 2 - known[1] ** 2, 0.0)))
                known = float(np.hypot(spread, sigma)), 0.0, known[2]
            if known and abs(known[1]) > max(NOISE_WARNING * known[0], NOISE_FRACTION * abs(value)):
                verb = "raises" if known[1] > 0.0 else "lowers"
                words += (f"measurement noise {verb} it by about {abs(known[1]):.2g} {kind.unit}".rstrip(),)
            yield Quantity(
                subject=measurand.name,
                name=name,
                unit=kind.unit,
                value=value if np.isfinite(value) else None,
                uncertainty=factor * known[0] if known else None,
                coverage_factor=factor,
                offset=known[1] if known else None,
                noise_taken_off=taken if known else None,
                samples=known[2] if known else 0,
                masked_share=measurand.masked_share,
                left_out_share=plan.areal.left_out_share if measurand is plan.areal else 0.0,
                warnings=words,
            )


def _notes(surface: ResultSurface, recipe: Recipe, samples: int) -> Iterable[str]:
    """Return notes on all numbers: samples, scale, warnings of the reconstruction."""
    if samples:
        own = uncertainty_of_uncertainty(samples)
        yield (
            f"± from {samples} Monte Carlo samples of the height error; "
            f"the relative uncertainty of each ± is {own:.0%} (k = 1)"
        )
    else:
        foreign = surface.record.method == FOREIGN_METHOD
        why = (
            "a foreign file states none"
            if foreign
            else f"the result holds no {SAMPLES_FILE}: reconstruct the scan again"
        )
        yield f"± not known: {why}"
    if samples and surface.slope_sigma is None:
        yield f"± without pixel noise finer than the samples: the result holds no {SLOPE_SIGMA_FILE}"
    scale = surface.record.height_scale
    for name, measured, stated in (
        ("pixel pitch", scale.pixel_pitch_share, recipe.scale.pixel_pitch_share),
        ("ball radius", scale.ball_radius_share, recipe.scale.ball_radius_share),
    ):
        if measured is not None:
            yield f"scale: ± of the {name} is included, {measured:.2%} as measured by the calibration"
        elif stated is not None:
            yield f"scale: ± of the {name} is included, {stated:.2%} as stated by the recipe"
        else:
            yield f"scale: ± of the {name} is not known and not included: set scale.{name.replace(' ', '_')}_share"
    if samples and recipe.scale.unlike_balls_share:
        yield f"scale: ± of {recipe.scale.unlike_balls_share:.1%} is included, for surfaces unlike the balls"
