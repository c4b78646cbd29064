"""What measuring gives: numbers, profiles, a spectrum, and what holds for all of them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from device.surface import Float32Array, Float64Array, HeightMap
from host_sync.measurement.power_spectrum import PowerSpectrum
from host_sync.measurement.profile_line import Line, Profile
from host_sync.measurement.quantity import Quantity
from host_sync.measurement.recipe import Recipe
from host_sync.measurement.result_surface import ResultRecord


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredProfile:
    """A profile and its standard uncertainty, which is None without draws; float64 array of shape (N,), µm."""

    name: str
    line: Line
    profile: Profile
    sigma_um: Float64Array | None


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredSpectrum:
    """A power spectral density and its standard uncertainty, which is None without draws; shape (N,), µm³."""

    spectrum: PowerSpectrum
    sigma_um3: Float64Array | None


@dataclass(frozen=True, slots=True, eq=False)
class Measurement:
    """What a recipe gives on one result.

    height : the whole height map
    surface : the scale-limited surface of the region
    sigma_um : float32 array of shape (H, W), standard uncertainty of the height, if the result holds it
    notes : what holds for all numbers, sentence by sentence
    """

    folder: Path
    record: ResultRecord
    recipe: Recipe
    quantities: tuple[Quantity, ...]
    notes: tuple[str, ...]
    height: HeightMap
    surface: HeightMap
    sigma_um: Float32Array | None
    profiles: tuple[MeasuredProfile, ...]
    spectrum: MeasuredSpectrum | None
