"""The result of a measurement: quantities, profiles, a spectrum, and notes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np

from device.surface import Float32Array, Float64Array, HeightMap, MaskArray
from host_sync.csv_table import table_text
from host_sync.iso25178.power_spectrum import PowerSpectrum
from host_sync.measurement.quantity import Quantity
from host_sync.measurement.recipe import Recipe
from host_sync.profile.profile_line import Line, Profile
from host_sync.results.record import Doubt, ResultRecord

COPY: Final = "copy"
"""Warning that a number is that of a frame which was measured before."""

STEPPED: Final = "Std"
"""A direction comes in steps of half a degree: different presses may agree."""


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

    No two presses have the same noise. Unknown values, and values in steps, are not compared.
    """
    first: dict[object, Measurement] = {}
    numbers = [
        tuple(
            (part.subject, part.name, part.value)
            for part in one.quantities
            if part.name != STEPPED and part.value is not None and np.isfinite(part.value)
        )
        for one in measurements
    ]
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


# A measurement as text, as a record for JSON, and as rows for CSV.

SCHEMA: Final = "retrograph.measurement/1"

CSV_COLUMNS: Final = (
    "result",
    "scan_id",
    "subject",
    "name",
    "value",
    "uncertainty",
    "coverage_factor",
    "unit",
    "masked_percent",
    "draws",
    "offset",
    "doubts",
    "low",
    "high",
    "verdict",
    "left_out_percent",
)


def operations(recipe: Recipe) -> str:
    """Return the operations on the surface, in order: "form: plane; S-filter: none; L-filter: 800 µm (Gaussian, …)"."""
    parts = [f"form removed: {recipe.form}" + ("" if recipe.form == "none" else " (least squares)")]
    for name, index_um in (("S", recipe.s_filter_um), ("L", recipe.l_filter_um)):
        if index_um is None:
            parts.append(f"{name}-filter: none")
        else:
            parts.append(f"{name}-filter: nesting index {index_um:g} µm (Gaussian, ISO 16610-61)")
    region = recipe.region_um
    if recipe.level is not None:
        parts.insert(0, f"levelled on: {recipe.level.on}")
    place = "whole field" if region is None else "region {:g} {:g} {:g} {:g} µm".format(*region)
    return "; ".join([place, *parts])


def as_text(measurement: Measurement) -> str:
    """Return a table: operations, one line per quantity with its warnings, and notes."""
    record = measurement.record
    lines = [f"{record.name}  ({measurement.folder})", operations(measurement.recipe)]
    lines += [f"doubt: {doubt.sentence}" for doubt in measurement.doubts]
    for subject, quantities in groupby(measurement.quantities, key=lambda one: one.subject):
        group = list(quantities)
        factor = f"k = {group[0].coverage_factor}"
        lines.append("")
        lines.append(f"{subject}  ({factor}, {group[0].coverage})")
        width = max(len(one.name) for one in group)
        for one in group:
            verdict = f"   {one.limits.words}" if one.limits else ""
            lines.append(f"  {one.name:<{width}}  {one.number}{verdict}")
            lines.extend(
                f"  {'':<{width}}    warning: {warning}"
                for warning in one.warnings
                if warning not in shared_warnings(group)
            )
        lines.extend(f"  warning: {warning}" for warning in shared_warnings(group))
    lines += ["", *(f"- {note}" for note in measurement.notes)]
    return "\n".join(lines)


def as_record(measurement: Measurement) -> dict[str, Any]:
    """Return the record that `--json` writes; quantities state their unit, arrays are in µm."""
    record = measurement.record
    return {
        "schema": SCHEMA,
        "result": str(measurement.folder),
        "name": record.name,
        "scan_id": record.scan_id,
        "calibration_id": record.calibration_id,
        "program": record.program,
        "recipe": measurement.recipe,
        "operations": operations(measurement.recipe),
        "quantities": [msgspec.to_builtins(one) | {"sentence": one.sentence} for one in measurement.quantities],
        "notes": measurement.notes,
        "doubts": measurement.doubts,
        "failed": measurement.failed,
        "profiles": [
            {
                "name": one.name,
                "step_um": one.profile.step_um,
                "z_um": _numbers(one.profile.z_um),
                "sigma_um": None if one.sigma_um is None else _numbers(one.sigma_um),
                "doubts": one.doubts,
            }
            for one in measurement.profiles
        ],
        "steps": [
            {"name": one.name, "edges_um": one.edges_um, "step_um": one.profile.step_um, "doubts": one.doubts}
            for one in measurement.steps
        ],
        "spectrum": _spectrum(measurement),
    }


def as_csv(measurements: Sequence[Measurement], *, semicolon: bool = False) -> str:
    """Return rows of all quantities of several results, with a header.

    semicolon : as for `table_text`
    """
    rows = [_row(measurement, one) for measurement in measurements for one in measurement.quantities]
    return table_text([CSV_COLUMNS, *rows], semicolon=semicolon)


def _row(measurement: Measurement, one: Quantity) -> list[object]:
    record, limits = measurement.record, one.limits
    return [
        measurement.folder, record.scan_id, one.subject, one.name, one.value, one.uncertainty, one.coverage_factor,
        one.unit, float(f"{100.0 * one.masked_share:.4g}"), one.samples, one.offset, "; ".join(one.warnings),
        *((None, None, None) if limits is None else (limits.low, limits.high, limits.verdict)),
        float(f"{100.0 * one.left_out_share:.4g}"),
    ]  # fmt: skip


def shared_warnings(group: Sequence[Quantity]) -> tuple[str, ...]:
    """Return warnings that all quantities of a group share."""
    return tuple(
        warning for warning in group[0].warnings if all(warning in one.warnings for one in group) and len(group) > 1
    )


def _numbers(values: np.ndarray) -> list[float | None]:
    return [float(value) if np.isfinite(value) else None for value in values]


def _spectrum(measurement: Measurement) -> dict[str, Any] | None:
    found = measurement.spectrum
    if found is None:
        return None
    return {
        "frequency_per_um": _numbers(found.spectrum.per_um),
        "width_per_um": _numbers(found.spectrum.width_per_um),
        "density_um3": _numbers(found.spectrum.density_um3),
        "sigma_um3": None if found.sigma_um3 is None else _numbers(found.sigma_um3),
    }
