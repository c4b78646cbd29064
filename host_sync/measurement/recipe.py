"""A measurement recipe: what is done to a surface and what is measured on it, in a TOML file that can be used again.

Lengths are µm; places are (column, row) and regions (left, top, right, bottom), from the middle of the field's first
pixel.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Final, Literal

import msgspec

from host_sync.errors import MeasurementError
from host_sync.measurement.areal_catalogue import AREAL, AREAL_SUBJECT, GROUPS
from host_sync.measurement.form import HIGHEST_DEGREE
from host_sync.measurement.height_draws import StatedScale
from host_sync.measurement.recipe_words import recipe_problem
from host_sync.measurement.step_height import StepKind

FORMS: Final = ("none", "mean", "plane", "sphere", *(f"polynomial-{degree}" for degree in range(2, HIGHEST_DEGREE + 1)))

Length = Annotated[float, msgspec.Meta(gt=0, le=1e7)]
Coordinate = Annotated[float, msgspec.Meta(ge=-1e7, le=1e7)]
Place = tuple[Coordinate, Coordinate]
Rectangle = tuple[Coordinate, Coordinate, Coordinate, Coordinate]
Percent = Annotated[float, msgspec.Meta(gt=0, lt=100)]
Label = Annotated[str, msgspec.Meta(min_length=1, max_length=80)]


class _Table(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A table of the file: unknown keys are refused."""


class ProfileTable(_Table, frozen=True):
    """A profile along a line and its parameters; the L-filter's nesting index is the section length too.

    width_um : the profile is the mean over so much across the line
    form_degree : of the polynomial that is taken off the profile first
    """

    name: Label
    from_um: Place
    to_um: Place
    width_um: Annotated[float, msgspec.Meta(ge=0, le=1e6)] = 0.0
    s_filter_um: Length | None = None
    l_filter_um: Length | None = None
    sections: Annotated[int, msgspec.Meta(ge=1, le=100)] = 5
    form_degree: Annotated[int, msgspec.Meta(ge=0, le=HIGHEST_DEGREE)] = 1


class StepTable(_Table, frozen=True):
    """A step or a groove (or ridge) across a line; edges are places along it, found when they are not given."""

    name: Label
    from_um: Place
    to_um: Place
    width_um: Annotated[float, msgspec.Meta(ge=0, le=1e6)] = 0.0
    kind: StepKind = "step"
    edges_um: tuple[Coordinate, ...] | None = None


class DistanceTable(_Table, frozen=True):
    """Distances and the slope from one place to another."""

    name: Label
    from_um: Place
    to_um: Place


class AngleTable(_Table, frozen=True):
    """The angle between the planes of two regions."""

    name: Label
    first_um: Rectangle
    second_um: Rectangle


class RadiusTable(_Table, frozen=True):
    """The radius of the sphere through a region."""

    name: Label
    region_um: Rectangle


class VolumeTable(_Table, frozen=True):
    """Volumes under and over the plane through the border of a region, which is `border_um` wide."""

    name: Label
    region_um: Rectangle
    border_um: Length


class Recipe(_Table, frozen=True):
    """The whole file.

    coverage_factor : k, by which standard uncertainties are multiplied
    keep_extrapolated : measure pixels too whose slopes lie beyond what the calibration taught
    form : what is taken off first, by least squares
    s_filter_um, l_filter_um : nesting indices of the areal Gaussian filters
    parameters : groups or single names; those of `smr_um` and `smc_percent` come with the functional ones
    smr_um : heights from the mean plane for Smr
    smc_percent : material ratios for Smc
    spectrum : whether the power spectral density is measured too
    scale : standard uncertainties that the calibration did not measure
    """

    name: str = ""
    coverage_factor: Literal[1, 2] = 1
    region_um: Rectangle | None = None
    keep_extrapolated: bool = False
    form: str = "plane"
    s_filter_um: Length | None = None
    l_filter_um: Length | None = None
    parameters: tuple[str, ...] = tuple(GROUPS)
    smr_um: tuple[Coordinate, ...] = ()
    smc_percent: tuple[Percent, ...] = ()
    spectrum: bool = False
    scale: StatedScale = StatedScale()
    profile: tuple[ProfileTable, ...] = ()
    step: tuple[StepTable, ...] = ()
    distance: tuple[DistanceTable, ...] = ()
    angle: tuple[AngleTable, ...] = ()
    radius: tuple[RadiusTable, ...] = ()
    volume: tuple[VolumeTable, ...] = ()


def from_options(recipe: Recipe, given: Mapping[str, object]) -> Recipe:
    """The recipe with other values at some keys, checked as those of a file are.

    Raises
    ------
    MeasurementError
        Names the key, what is wrong with it and what is accepted.
    """
    try:
        return msgspec.convert(msgspec.to_builtins(recipe) | dict(given), Recipe)
    except msgspec.ValidationError as error:
        raise MeasurementError(f"options: {_told(error)}") from error


_TABLES: Final = {
    "": Recipe,
    "scale": StatedScale,
    "profile": ProfileTable,
    "step": StepTable,
    "distance": DistanceTable,
    "angle": AngleTable,
    "radius": RadiusTable,
    "volume": VolumeTable,
}
_ACCEPTED: Final = {"coverage_factor": "1, 2", "kind": "'groove', 'step'"}


def read_recipe(path: Path) -> Recipe:
    """The recipe of a file, each key checked.

    Raises
    ------
    MeasurementError
        Names the file, the key, what is wrong with it and what is accepted.
    """
    try:
        recipe = msgspec.toml.decode(path.read_bytes(), type=Recipe)
    except OSError as error:
        raise MeasurementError(f"{path}: cannot be read ({error.strerror}): name a recipe in TOML") from error
    except msgspec.ValidationError as error:
        raise MeasurementError(f"{path}: {_told(error)}") from error
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise MeasurementError(f"{path}: is not TOML: {error}") from error
    return checked(recipe, str(path))


def checked(recipe: Recipe, source: str) -> Recipe:
    """The recipe itself, when its keys agree with one another.

    source : what errors name

    Raises
    ------
    MeasurementError
        Names the key, what is wrong with it and what is accepted.
    """
    if recipe.form not in FORMS:
        raise MeasurementError(f"{source}: form: {recipe.form!r} is none; accepted are {', '.join(FORMS)}")
    known = (*GROUPS, *AREAL)
    for name in recipe.parameters:
        if name not in known:
            raise MeasurementError(f"{source}: parameters: {name!r} is none; accepted are {', '.join(known)}")
    bands = [("", recipe.s_filter_um, recipe.l_filter_um)]
    bands += [(f"profile[{i}].", one.s_filter_um, one.l_filter_um) for i, one in enumerate(recipe.profile)]
    for where, s_um, l_um in bands:
        if s_um is not None and l_um is not None and s_um >= l_um:
            raise MeasurementError(
                f"{source}: {where}s_filter_um: {s_um:g} takes away all that l_filter_um = {l_um:g} leaves: "
                "accepted is less than that"
            )
    _check_names(recipe, source)
    for i, step in enumerate(recipe.step):
        wanted = 1 if step.kind == "step" else 2
        if step.edges_um is not None and (
            len(step.edges_um) != wanted or list(step.edges_um) != sorted(set(step.edges_um))
        ):
            raise MeasurementError(
                f"{source}: step[{i}].edges_um: a {step.kind} has {wanted}: accepted is a list of so many, rising"
            )
    return recipe


def _check_names(recipe: Recipe, source: str) -> None:
    """Refuse two lines, places or regions of one name: nobody could tell their numbers apart."""
    named = (recipe.profile, recipe.step, recipe.distance, recipe.angle, recipe.radius, recipe.volume)
    seen = {AREAL_SUBJECT}
    for table in (table for tables in named for table in tables):
        if table.name in seen:
            raise MeasurementError(f"{source}: name: {table.name!r} is there twice: accepted is a name of its own")
        seen.add(table.name)


def _told(error: msgspec.ValidationError) -> str:
    """The key, what is wrong there, and what may stand there."""
    key, problem = recipe_problem(error)
    table = re.sub(r"\[.*?\]", "", key)
    last = table.rpartition(".")[2]
    if problem.endswith("is no key"):
        problem += f"; accepted keys are {', '.join(_TABLES.get(table, Recipe).__struct_fields__)}"
    elif last in _ACCEPTED:
        problem += f"; accepted are {_ACCEPTED[last]}"
    return f"{key}: {problem}" if key else problem
