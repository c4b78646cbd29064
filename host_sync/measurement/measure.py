"""Measures a result by a recipe: numbers on the height map, then on every surface that its draws allow."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from device.surface import Float32Array, Float64Array, HeightMap
from host_sync.errors import MeasurementError
from host_sync.measurement.areal_catalogue import ParameterKind
from host_sync.measurement.areal_measurand import ArealMeasurand
from host_sync.measurement.height_draws import HeightDraws
from host_sync.measurement.measurands import (
    AngleMeasurand,
    DistanceMeasurand,
    Measurand,
    RadiusMeasurand,
    StepMeasurand,
    VolumeMeasurand,
)
from host_sync.measurement.measurement import MeasuredProfile, MeasuredSpectrum, Measurement
from host_sync.measurement.power_spectrum import PowerSpectrum, RadialSpectrum
from host_sync.measurement.profile_line import Profile
from host_sync.measurement.profile_measurand import ProfileMeasurand
from host_sync.measurement.quantity import (
    NOISE_DOUBT,
    NOISE_SHARE,
    Quantity,
    uncertainty_of,
    uncertainty_of_uncertainty,
)
from host_sync.measurement.recipe import Recipe
from host_sync.measurement.result_surface import ResultSurface, read_result

DIRECTION: Final = "Std"
NO_SHAPE_SIGMA: Final = "± not stated: without an L-filter waviness rules it, which slopes know least: set l_filter_um"

Numbers = Mapping[str, float]


@dataclass(frozen=True, slots=True, eq=False)
class _Look:
    """What one surface shows.

    numbers : of each measurand
    traces : the profiles, then the spectrum's densities if asked for; each float64 array of shape (N,)
    """

    surface: HeightMap
    numbers: Sequence[Numbers]
    traces: Sequence[Float64Array]


class _Instrument:
    """All measurands of a recipe on one height map."""

    def __init__(self, surface: ResultSurface, recipe: Recipe) -> None:
        height = surface.height
        self.areal = ArealMeasurand(recipe, height, surface.extrapolated)
        self.profiles = [ProfileMeasurand(table, height) for table in recipe.profile]
        self.others: list[Measurand] = [*self.profiles, *_others(recipe, height)]
        self._spectrum: RadialSpectrum | None = None
        if recipe.spectrum:
            self._spectrum = RadialSpectrum(self.areal.valid, height.pitch_um)

    @property
    def measurands(self) -> list[Measurand]:
        return [self.areal, *self.others]

    def look(self, z_um: Float32Array, stretch: float = 1.0) -> _Look:
        """What a height map of shape (H, W) shows, lengths along the skin longer by a factor.

        Raises
        ------
        MeasurementError
            It does not show what is asked for.
        """
        limited = self.areal.surface(z_um)
        numbers = [self.areal.parameters(limited.z_um), *(one.values(z_um) for one in self.others)]
        traces = [one.trace(z_um).z_um for one in self.profiles]
        if self._spectrum is not None:
            traces.append(self._spectrum.of(limited.z_um).density_um3)
        kinds = [one.kinds() for one in self.measurands]
        return _Look(limited, [_stretched(*pair, stretch) for pair in zip(numbers, kinds, strict=True)], traces)

    def spectrum(self, look: _Look) -> PowerSpectrum | None:
        """The spectrum of a look."""
        bands = self._spectrum
        return None if bands is None else PowerSpectrum(bands.per_um, bands.width_per_um, look.traces[-1])


def measure_result(
    folder: Path, recipe: Recipe, tell: Callable[[str], None] = lambda _: None, *, draws: bool = True
) -> Measurement:
    """The measurement of a result folder.

    draws : whether each number gets its ±; without, a measurement takes a fraction of the time

    Raises
    ------
    MeasurementError
        The result is damaged, or does not show what the recipe asks for.
    """
    tell(f"{folder.name}: reading")
    surface = read_result(folder)
    return measure(surface if draws else replace(surface, draws_um=None), recipe, tell)


def measure(surface: ResultSurface, recipe: Recipe, tell: Callable[[str], None] = lambda _: None) -> Measurement:
    """The measurement of a surface; errors as for `measure_result`."""
    instrument = _Instrument(surface, recipe)
    found = instrument.look(surface.height.z_um)
    draws = HeightDraws(surface, recipe.scale)
    drawn: list[Sequence[Numbers]] = []
    squares = [np.zeros_like(trace) for trace in found.traces]
    for number, allowed in enumerate(draws.surfaces(), start=1):
        tell(f"{surface.folder.name}: draw {number} of {len(draws)}")
        try:
            look = instrument.look(allowed.z_um, allowed.stretch)
        except MeasurementError:
            continue  # a surface that does not show what is asked for gives no number; each says how many draws it has
        drawn.append(look.numbers)
        for square, trace, first in zip(squares, look.traces, found.traces, strict=True):
            square += (trace - first) ** 2
    sigmas = [np.sqrt(square / len(drawn)) if drawn else None for square in squares]
    spectrum = instrument.spectrum(found)
    return Measurement(
        folder=surface.folder,
        record=surface.record,
        recipe=recipe,
        quantities=tuple(_quantities(instrument, found.numbers, drawn, recipe.coverage_factor)),
        notes=(*instrument.areal.notes(), *_notes(surface, recipe, len(draws))),
        height=surface.height,
        surface=found.surface,
        sigma_um=surface.sigma_um,
        profiles=tuple(
            MeasuredProfile(one.name, one.line, Profile(trace, surface.height.pitch_um), sigma)
            for one, trace, sigma in zip(instrument.profiles, found.traces, sigmas, strict=False)
        ),
        spectrum=MeasuredSpectrum(spectrum, sigmas[-1]) if spectrum else None,
    )


def _others(recipe: Recipe, height: HeightMap) -> Iterable[Measurand]:
    for step in recipe.step:
        yield StepMeasurand(step, height)
    for distance in recipe.distance:
        yield DistanceMeasurand(distance, height)
    for angle in recipe.angle:
        yield AngleMeasurand(angle, height)
    for radius in recipe.radius:
        yield RadiusMeasurand(radius, height)
    for volume in recipe.volume:
        yield VolumeMeasurand(volume, height)


def _stretched(numbers: Numbers, kinds: Mapping[str, ParameterKind], stretch: float) -> Numbers:
    return {name: float(numbers[name]) * stretch**kind.stretch_power for name, kind in kinds.items()}


def _quantities(
    instrument: _Instrument, found: Sequence[Numbers], drawn: Sequence[Sequence[Numbers]], factor: int
) -> Iterable[Quantity]:
    for index, (measurand, numbers) in enumerate(zip(instrument.measurands, found, strict=True)):
        doubts = measurand.doubts()
        for name, kind in measurand.kinds().items():
            value = numbers[name]
            others = np.array([look[index][name] for look in drawn])
            known = uncertainty_of(value, others, is_direction=name == DIRECTION)
            if known and known[0] == 0.0:
                known = None  # it hangs on nothing that the draws vary: a length along the skin whose pitch has no ±
            words = (*doubts.get("", ()), *doubts.get(name, ()))
            if known and measurand is instrument.areal and name in instrument.areal.without_sigma:
                known, words = None, (*words, NO_SHAPE_SIGMA)
            if known and abs(known[1]) > max(NOISE_DOUBT * known[0], NOISE_SHARE * abs(value)):
                verb = "raises" if known[1] > 0.0 else "lowers"
                words += (f"noise of the measurement {verb} it by about {abs(known[1]):.2g} {kind.unit}".rstrip(),)
            yield Quantity(
                subject=measurand.name,
                name=name,
                unit=kind.unit,
                value=value if np.isfinite(value) else None,
                uncertainty=factor * known[0] if known else None,
                coverage_factor=factor,
                offset=known[1] if known else None,
                draws=known[2] if known else 0,
                masked_share=measurand.masked_share,
                doubts=words,
            )


def _notes(surface: ResultSurface, recipe: Recipe, draws: int) -> Iterable[str]:
    """What holds for every number: draws, scale, warnings of the reconstruction."""
    if draws:
        own = uncertainty_of_uncertainty(draws)
        yield f"± from {draws} draws of the height error, so that each ± is itself sure to {own:.0%} (k = 1)"
    else:
        yield "± not known: the result holds no height_draws_um.tif: reconstruct the scan again"
    if draws and surface.slope_sigma is None:
        yield "± without pixel noise finer than the draws: the result holds no slope_sigma.tif"
    scale = surface.record.height_scale
    for name, measured, stated in (
        ("pixel pitch", scale.pixel_pitch_share, recipe.scale.pixel_pitch_share),
        ("ball radius", scale.ball_radius_share, recipe.scale.ball_radius_share),
    ):
        if measured is not None:
            yield f"scale: ± of the {name} is in, {measured:.2%} as the calibration measured it"
        elif stated is not None:
            yield f"scale: ± of the {name} is in, {stated:.2%} as the recipe states it"
        else:
            yield f"scale: ± of the {name} is not known and not in: state scale.{name.replace(' ', '_')}_share"
    if draws and recipe.scale.unlike_balls_share:
        yield f"scale: ± of {recipe.scale.unlike_balls_share:.1%} is in, for surfaces unlike the balls"
    for warning in surface.record.warnings:
        yield f"reconstruction: {warning}"
