"""The result of a measurement: quantities, profiles, a spectrum, and notes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import msgspec
import numpy as np

from device.surface.fields import Float32Array, Float64Array, HeightMap, MaskArray
from host_sync.iso25178.power_spectrum import PowerSpectrum
from host_sync.measurement.quantity import Quantity
from host_sync.measurement.recipe import Recipe
from host_sync.profile.profile_line import Line, Profile
from host_sync.results.doubt import Doubt
from host_sync.results.record import ResultRecord

COPY: Final = "copy"
"""Warning that a number is that of a frame which was measured before."""


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredProfile:
    """A profile and its standard uncertainty: float64 array of shape (N,), µm; None without samples."""

    name: str
    line: Line
    profile: Profile
    sigma_um: Float64Array | None
    doubts: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredStep:
    """A step's profile with what was found on it.

    base_um, top_um : float64 arrays of shape (N,), the lines fitted beside and in it (left and right of a step), µm
    used : bool array of shape (N,), samples that they are fitted to
    """

    name: str
    line: Line
    profile: Profile
    edges_um: tuple[float, ...]
    base_um: Float64Array
    top_um: Float64Array
    used: MaskArray
    doubts: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredSpectrum:
    """A power spectral density and its standard uncertainty: float64 array of shape (N,), µm³; None without samples."""

    spectrum: PowerSpectrum
    sigma_um3: Float64Array | None


@dataclass(frozen=True, slots=True, eq=False)
class Measurement:
    """A recipe evaluated on one result.

    height : the whole height map
    surface : the scale-limited surface of the region
    sigma_um : float32 array of shape (H, W), standard uncertainty of the height; None if unknown
    notes : sentences that concern all quantities
    doubts : of the whole result; each quantity and profile states those that concern it
    failed : names of what the recipe asks for and the result does not show
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
    doubts: tuple[Doubt, ...] = ()
    steps: tuple[MeasuredStep, ...] = ()
    failed: tuple[str, ...] = ()

    @property
    def fails(self) -> bool:
        """True if a number fails its tolerance."""
        return any(one.limits is not None and one.limits.verdict == "fail" for one in self.quantities)

    def numbers_only(self) -> Measurement:
        """Return the same without maps, profiles and spectrum: a few kilobytes, of which thousands fit into memory.

        Height and surface are one invalid pixel.
        """
        nothing = HeightMap(np.full((1, 1), np.nan, np.float32), self.height.pitch_um)
        return replace(self, height=nothing, surface=nothing, sigma_um=None, profiles=(), spectrum=None, steps=())


def copies_among(measurements: Sequence[Measurement]) -> dict[int, Measurement]:
    """Return which measurements copy an earlier one, by their places: all numbers agree, so they are of one frame.

    No two presses have the same noise.
    """
    first: dict[object, Measurement] = {}
    numbers = [tuple((part.subject, part.name, part.value) for part in one.quantities) for one in measurements]
    earlier = [first.setdefault(key or place, measurements[place]) for place, key in enumerate(numbers)]
    return {place: one for place, one in enumerate(earlier) if one is not measurements[place]}


def copy_words(one: Measurement, first: Measurement) -> str:
    """Return what is wrong with a measurement that copies an earlier one, names in front."""
    if one.folder.resolve() == first.folder.resolve():
        return f"{one.folder}: is named twice, and one press is measured once"
    return f"{one.folder}: is a copy of {first.folder}, not another press"


def mark_copies(measurements: Sequence[Measurement]) -> list[Measurement]:
    """Return the measurements, each number of a copy with a warning that it is one."""
    marked = list(measurements)
    for place, first in copies_among(measurements).items():
        said = f"{COPY}: of {first.folder}, not another press"
        quantities = [msgspec.structs.replace(one, warnings=(*one.warnings, said)) for one in marked[place].quantities]
        marked[place] = replace(marked[place], quantities=tuple(quantities))
    return marked
