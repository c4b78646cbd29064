"""A measurement recipe: the operations on a surface and the quantities measured on it, as a TOML file.

Lengths are µm; places are (column, row) and regions (left, top, right, bottom), from the centre of the field's first
pixel.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import msgspec
import numpy as np

from hal.validation import decode_toml, split_validation
from host_sync.errors import MeasurementError
from host_sync.filters.form import MAX_DEGREE
from host_sync.iso25178.areal_parameters import AREAL, AREAL_SUBJECT, GROUPS
from host_sync.measurement.height_samples import StatedScale
from host_sync.profile.step_height import StepKind
from host_sync.results.files import DetailName

FORMS: Final = ("none", "mean", "plane", "sphere", *(f"polynomial-{degree}" for degree in range(2, MAX_DEGREE + 1)))

Length = Annotated[float, msgspec.Meta(gt=0, le=1e7)]
Coordinate = Annotated[float, msgspec.Meta(ge=-1e7, le=1e7)]
Place = tuple[Coordinate, Coordinate]
Rectangle = tuple[Coordinate, Coordinate, Coordinate, Coordinate]
Percent = Annotated[float, msgspec.Meta(gt=0, lt=100)]
Limit = Annotated[float, msgspec.Meta(ge=-1e15, le=1e15)]
Label = Annotated[str, msgspec.Meta(min_length=1, max_length=80)]


class _Table(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A table of the file; unknown keys are refused."""


class LevelTable(_Table, frozen=True):
    """Skin, points, line or plane that a height map is levelled on before anything is measured.

    on : untouched skin (found, or `regions_um`), three or more points, a line between two points (the slope across it
        stays), or the plane through `regions_um`
    """

    on: Literal["skin", "points", "line", "plane"]
    points_um: tuple[Place, ...] = ()
    regions_um: tuple[Rectangle, ...] = ()


class ProfileTable(_Table, frozen=True):
    """A profile along a line and its parameters; the L-filter's nesting index is also the section length.

    width_um : width across the line over which the profile is averaged
    form_degree : degree of the polynomial that is subtracted first
    """

    name: Label
    from_um: Place
    to_um: Place
    width_um: Annotated[float, msgspec.Meta(ge=0, le=1e6)] = 0.0
    s_filter_um: Length | None = None
    l_filter_um: Length | None = None
    sections: Annotated[int, msgspec.Meta(ge=1, le=100)] = 5
    form_degree: Annotated[int, msgspec.Meta(ge=0, le=MAX_DEGREE)] = 1


class StepTable(_Table, frozen=True):
    """A step, groove or ridge across a line; edges are distances along it, detected by default."""

    name: Label
    from_um: Place
    to_um: Place
    width_um: Annotated[float, msgspec.Meta(ge=0, le=1e6)] = 0.0
    kind: StepKind = "step"
    edges_um: tuple[Coordinate, ...] | None = None


class DistanceTable(_Table, frozen=True):
    """Distances and slope between two places."""

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
    """Volumes below and above the plane through the border of a region, `border_um` wide."""

    name: Label
    region_um: Rectangle
    border_um: Length


class CircleTable(_Table, frozen=True):
    """A round edge near a circle: its diameter, centre and roundness."""

    name: Label
    centre_um: Place
    radius_um: Length


class MaskTable(_Table, frozen=True):
    """A stroke of a brush: what lies under it is not measured.

    points_um : the brush's way
    """

    points_um: Annotated[tuple[Place, ...], msgspec.Meta(min_length=1, max_length=10_000)]
    width_um: Length


class ToleranceTable(_Table, frozen=True):
    """Limits of one number, in its unit.

    number : such as "Sa", "height" or "diameter"
    of : the name of what is measured; `surface` for areal parameters
    """

    number: Label
    of: Label = AREAL_SUBJECT
    low: Limit | None = None
    high: Limit | None = None


class Recipe(_Table, frozen=True):
    """The whole file.

    coverage_factor : k, the factor on standard uncertainties
    keep_extrapolated : include pixels whose slopes lie beyond the calibration's training samples
    level : what the height map is levelled on first; as reconstruction left it by default
    form : the form that is removed first, by least squares
    s_filter_um, l_filter_um : nesting indices of the areal Gaussian filters
    parameters : names of parameters or groups
    smr_um : heights from the mean plane for Smr
    smc_percent : material ratios for Smc
    spectrum : whether to measure the power spectral density
    scale : standard uncertainties that the calibration does not measure
    mask : what is not measured
    tolerance : limits of numbers
    detail : of the height map that everything is measured on; None measures parameters of surface and profiles on raw
        detail, its noise subtracted, and steps, radii, distances, angles and volumes on shrunk detail
    """

    name: str = ""
    coverage_factor: Literal[1, 2] = 1
    region_um: Rectangle | None = None
    keep_extrapolated: bool = False
    level: LevelTable | None = None
    form: str = "plane"
    s_filter_um: Length | None = None
    l_filter_um: Length | None = None
    parameters: tuple[str, ...] = tuple(GROUPS)
    smr_um: tuple[Coordinate, ...] = ()
    smc_percent: tuple[Percent, ...] = ()
    spectrum: bool = False
    scale: StatedScale = StatedScale()
    detail: DetailName | None = None
    profile: tuple[ProfileTable, ...] = ()
    step: tuple[StepTable, ...] = ()
    distance: tuple[DistanceTable, ...] = ()
    angle: tuple[AngleTable, ...] = ()
    radius: tuple[RadiusTable, ...] = ()
    volume: tuple[VolumeTable, ...] = ()
    circle: tuple[CircleTable, ...] = ()
    mask: tuple[MaskTable, ...] = ()
    tolerance: tuple[ToleranceTable, ...] = ()


def from_options(recipe: Recipe, given: Mapping[str, object]) -> Recipe:
    """Return the recipe with the given keys replaced, checked like a file.

    Raises
    ------
    MeasurementError
        Names the key, what is wrong with it and what is accepted.
    """
    try:
        plain = msgspec.to_builtins(dict(given), enc_hook=lambda value: np.asarray(value).tolist())
        return msgspec.convert(msgspec.to_builtins(recipe) | plain, Recipe)
    except msgspec.ValidationError as error:
        raise MeasurementError(f"options: {_explained(error)}") from error


_TABLES: Final = {
    "": Recipe,
    "scale": StatedScale,
    "level": LevelTable,
    "profile": ProfileTable,
    "step": StepTable,
    "distance": DistanceTable,
    "angle": AngleTable,
    "radius": RadiusTable,
    "volume": VolumeTable,
    "circle": CircleTable,
    "mask": MaskTable,
    "tolerance": ToleranceTable,
}
_ACCEPTED: Final = {
    "coverage_factor": "1, 2",
    "detail": "'raw', 'shrunk'",
    "kind": "'groove', 'ridge', 'step'",
    "on": "'skin', 'points', 'line', 'plane'",
}


def read_recipe(path: Path) -> Recipe:
    """Return the recipe of a file, each key checked.

    Raises
    ------
    MeasurementError
        Names the file, the key, what is wrong with it and what is accepted.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise MeasurementError(f"{path}: cannot be read ({error.strerror}): name a recipe in TOML") from error
    return recipe_of(data, str(path))


def recipe_of(data: bytes, source: str) -> Recipe:
    """Return the recipe in a file's bytes; errors as for `read_recipe`.

    source : its name in errors
    """
    try:
        recipe = decode_toml(data, Recipe)
    except msgspec.ValidationError as error:
        raise MeasurementError(f"{source}: {_explained(error)}") from error
    except msgspec.DecodeError as error:
        raise MeasurementError(f"{source}: {error}") from error
    return checked(recipe, source)


def checked(recipe: Recipe, source: str) -> Recipe:
    """Return the recipe, if its keys are consistent.

    source : its name in errors

    Raises
    ------
    MeasurementError
        Names the key, what is wrong with it and what is accepted.
    """
    if recipe.form not in FORMS:
        raise MeasurementError(f"{source}: form: {recipe.form!r} is not a form; accepted are {', '.join(FORMS)}")
    known = (*GROUPS, *AREAL)
    for name in recipe.parameters:
        if name not in known:
            words = f"parameters: {name!r} is unknown; accepted are {', '.join(known)}"
            of_lines = "; a line's parameters come with [[profile]]" if name[:1] in "PRW" else ""
            raise MeasurementError(f"{source}: {words}{of_lines}")
    bands = [("", recipe.s_filter_um, recipe.l_filter_um)]
    bands += [(f"profile[{i}].", one.s_filter_um, one.l_filter_um) for i, one in enumerate(recipe.profile)]
    for where, s_um, l_um in bands:
        if s_um is not None and l_um is not None and s_um >= l_um:
            raise MeasurementError(
                f"{source}: {where}s_filter_um: {s_um:g} removes all that l_filter_um = {l_um:g} leaves: "
                "accepted is less than that"
            )
    _check_level(recipe.level, source)
    _check_names(recipe, source)
    _check_tolerances(recipe, source)
    for i, step in enumerate(recipe.step):
        wanted = 1 if step.kind == "step" else 2
        if step.edges_um is not None and (
            len(step.edges_um) != wanted or list(step.edges_um) != sorted(set(step.edges_um))
        ):
            raise MeasurementError(
                f"{source}: step[{i}].edges_um: a {step.kind} has {wanted}: accepted is a rising list of {wanted}"
            )
    return recipe


def _check_level(level: LevelTable | None, source: str) -> None:
    """Refuse a level whose places do not fit its kind."""
    if level is None:
        return
    points, regions = len(level.points_um), len(level.regions_um)
    problem = {
        "skin": "points_um: untouched skin has none: accepted is regions_um, or nothing" if points else "",
        "points": "points_um: accepted are three points or more, and no regions_um" if points < 3 or regions else "",
        "line": "points_um: a line has two ends, and no regions_um" if points != 2 or regions else "",
        "plane": "regions_um: a plane needs one region or more, and no points_um" if points or not regions else "",
    }[level.on]
    if problem:
        raise MeasurementError(f"{source}: level.{problem}")


def _check_names(recipe: Recipe, source: str) -> None:
    """Refuse two lines, places or regions with the same name."""
    seen = {AREAL_SUBJECT}
    for name in _names(recipe):
        if name in seen:
            raise MeasurementError(f"{source}: name: {name!r} occurs twice: give each its own name")
        seen.add(name)


def _names(recipe: Recipe) -> list[str]:
    named = (recipe.profile, recipe.step, recipe.distance, recipe.angle, recipe.radius, recipe.volume, recipe.circle)
    return [table.name for tables in named for table in tables]


def _check_tolerances(recipe: Recipe, source: str) -> None:
    """Refuse limits of what the recipe does not measure, without an end, or in the wrong order."""
    known = (AREAL_SUBJECT, *_names(recipe))
    seen = set()
    for i, one in enumerate(recipe.tolerance):
        where = f"{source}: tolerance[{i}]"
        if one.of not in known:
            raise MeasurementError(f"{where}.of: {one.of!r} is not measured; accepted are {', '.join(known)}")
        if (one.of, one.number) in seen:
            raise MeasurementError(f"{where}.number: {one.number!r} of {one.of!r} occurs twice: give its limits once")
        if one.low is None and one.high is None:
            raise MeasurementError(f"{where}.low: a tolerance needs low, high or both")
        if one.low is not None and one.high is not None and one.low >= one.high:
            raise MeasurementError(f"{where}.low: {one.low:g} is not less than high = {one.high:g}")
        seen.add((one.of, one.number))


def _explained(error: msgspec.ValidationError) -> str:
    """Return the key, the problem, and what is accepted."""
    key, problem = split_validation(error)
    table = re.sub(r"\[.*?\]", "", key)
    last = table.rpartition(".")[2]
    if problem.endswith("is not a key"):
        problem += f"; accepted keys are {', '.join(_TABLES.get(table, Recipe).__struct_fields__)}"
    elif last in _ACCEPTED:
        problem += f"; accepted are {_ACCEPTED[last]}"
    elif last in _TABLES and problem.startswith("is a table"):
        problem += f": write [[{last}]]"
    elif last.endswith("_um") and (found := re.match(r"is a list of (\d+); accepted is a list of (\d+)", problem)):
        problem += ": write decimal points" if int(found[1]) == 2 * int(found[2]) else ""
    return f"{key}: {problem}" if key else problem


def recipe_text(recipe: Recipe) -> str:
    """Return the text of the recipe's file; `read_recipe` of it gives the same recipe."""
    given = dict(_given(recipe))
    lines = [f"{key} = {_value(value)}" for key, value in given.items() if not _is_table(value)]
    for key, value in given.items():
        tables = [value] if isinstance(value, msgspec.Struct) else value if _is_table(value) else ()
        bracket = f"[{key}]" if isinstance(value, msgspec.Struct) else f"[[{key}]]"
        for table in tables:
            lines += ["", bracket, *(f"{name} = {_value(part)}" for name, part in _given(table))]
    return "\n".join(lines).lstrip("\n") + "\n"


def _given(table: msgspec.Struct) -> Iterator[tuple[str, Any]]:
    """Yield keys and values that differ from the defaults."""
    for field in msgspec.structs.fields(table):
        value = getattr(table, field.name)
        if value is not None and (field.required or value != field.default):
            yield field.encode_name, value


def _is_table(value: object) -> bool:
    return isinstance(value, msgspec.Struct) or (
        isinstance(value, tuple) and bool(value) and isinstance(value[0], msgspec.Struct)
    )


def _value(value: object) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, tuple):
        return f"[{', '.join(_value(part) for part in value)}]"
    if isinstance(value, Mapping):
        raise TypeError("a recipe has no mapping")
    return repr(value)
