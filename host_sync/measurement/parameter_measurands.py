"""Areal parameters of the scale-limited surface, and profile parameters along a line, as measurands.

Form removal, S-filter and L-filter (ISO 25178-3) lead from a height map to that surface. They are set up for the mask
of one height map and then applied to its Monte Carlo samples as well. Nothing else is done: no outlier is removed, no
hole filled, nothing smoothed that the recipe does not state.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import cv2
import msgspec
import numpy as np

from device.quick_look.measures import MIN_CUTOFF_PX, ROUNDING
from device.surface import Float32Array, Float64Array, HeightMap, MaskArray
from host_sync.errors import MeasurementError
from host_sync.filters.form import FormRemoval, PolynomialForm
from host_sync.filters.gaussian_regression import GaussianRegression, profile_mean
from host_sync.iso25178.areal_parameters import (
    AMPLITUDE,
    AREAL,
    AREAL_SUBJECT,
    EXTREME,
    GROUPS,
    MOMENT,
    SLOPE,
    Autocorrelation,
    Decay,
    MaterialRatioCurve,
    ParameterKind,
    decay,
    functional_parameters,
    height_parameters,
    hybrid_parameters,
    texture_direction_deg,
)
from host_sync.measurement.circle_and_sphere import SphereForm
from host_sync.measurement.geometry import Region, SkinPlaces, field_places, line_places, region_places
from host_sync.measurement.measurands import Measurand
from host_sync.measurement.recipe import ProfileTable, Recipe
from host_sync.profile.profile_line import Line, Profile, profile_along, profile_parameters

_DEGREES: Final = {"mean": 0, "plane": 1}


def _check_l_filter(l_filter_um: float | None, pitch_um: float) -> None:
    """Refuse an L-filter that removes everything."""
    if l_filter_um is not None and l_filter_um < MIN_CUTOFF_PX * pitch_um:
        raise MeasurementError(
            f"l_filter_um: {l_filter_um:g} µm holds fewer than {MIN_CUTOFF_PX:g} pixels of {pitch_um:g} µm: "
            "choose a longer one"
        )


class Preparation:
    """Form removal and filters of a recipe, for one height map.

    Parameters
    ----------
    height : the measured region
    recipe : form and filters
    places : of the region's pixels

    Raises
    ------
    MeasurementError
        No pixel is valid, the form is not determined, or the L-filter is too short.
    """

    def __init__(self, height: HeightMap, recipe: Recipe, places: SkinPlaces) -> None:
        valid = np.isfinite(height.z_um)
        if not valid.any():
            raise MeasurementError(
                "every pixel of the region is masked or beyond the calibration: choose another, or keep_extrapolated"
            )
        _check_l_filter(recipe.l_filter_um, height.pitch_um)
        self._form = _form(recipe.form, height, places)
        formless = height.z_um if self._form is None else self._form.remove(height.z_um)
        self.valid = np.isfinite(formless)
        self._s, self._l = (
            None if index_um is None else GaussianRegression(self.valid, index_um / height.pitch_um)
            for index_um in (recipe.s_filter_um, recipe.l_filter_um)
        )
        self._longest_px = max(recipe.s_filter_um or 0.0, recipe.l_filter_um or 0.0) / height.pitch_um

    def apply(self, z_um: Float32Array) -> Float32Array:
        """Return the scale-limited surface: float32 array of shape (H, W), µm, NaN where invalid."""
        if self._form is not None:
            z_um = self._form.remove(z_um)
        if self._s is not None:
            z_um = self._s.mean(z_um)
        if self._l is not None:
            z_um = z_um - self._l.mean(z_um)
        return z_um

    def edge_fraction(self) -> float:
        """Return the fraction of valid pixels near a border or hole; 0 without filter.

        They lie within half the longest filter's nesting index of it.
        """
        if self._longest_px == 0.0:
            return 0.0
        framed = np.pad(self.valid.astype(np.uint8), 1)
        distance = cv2.distanceTransform(framed, cv2.DIST_L2, cv2.DIST_MASK_5)[1:-1, 1:-1]
        return float((distance[self.valid] < 0.5 * self._longest_px).mean())


def _form(name: str, height: HeightMap, places: SkinPlaces) -> FormRemoval | None:
    if name == "none":
        return None
    if name == "sphere":
        return SphereForm(places)
    degree = _DEGREES[name] if name in _DEGREES else int(name.rpartition("-")[2])
    return PolynomialForm(np.isfinite(height.z_um), degree)


EDGE_FRACTION: Final = 0.25
MASKED_FRACTION: Final = 0.1
BEYOND_FRACTION: Final = 0.005
"""Fractions of the area from which filter ends, holes and extrapolated slopes cause a warning."""

ISOTROPIC: Final = 0.5
"""Aspect ratio of a texture (Str) above which it is alike in all directions."""

MIN_LENGTHS: Final = 5.0
"""Fewest autocorrelation lengths along the shorter side of a representative field."""

FINEST_PX: Final = 2.0
"""A nesting index of fewer pixels has no effect."""


class ArealMeasurand(Measurand):
    """Form, filters and parameters of a recipe over its region.

    Parameters
    ----------
    recipe : region, form, filters and parameters
    height : the whole height map
    places : of its pixels
    extrapolated : bool array of shape (H, W), True where slopes lie beyond the calibration's training samples and
        skin is not known to be untouched; or None

    Attributes
    ----------
    masked_share, left_out_share : fractions of the region without a height, and left out as their slopes are
        extrapolated
    """

    name = AREAL_SUBJECT

    def __init__(self, recipe: Recipe, height: HeightMap, places: SkinPlaces, extrapolated: MaskArray | None) -> None:
        self._recipe = recipe
        self._pitch_um = height.pitch_um
        shape = (height.z_um.shape[0], height.z_um.shape[1])
        whole = (slice(0, shape[0]), slice(0, shape[1]))
        self._window = Region(*recipe.region_um).pixels(shape, height.pitch_um) if recipe.region_um else whole
        beyond = None if extrapolated is None else extrapolated[self._window]
        self._left_out = None if recipe.keep_extrapolated else beyond
        self.places_px = (
            region_places([Region(*recipe.region_um)], height.pitch_um) if recipe.region_um else field_places(shape)
        )
        part = HeightMap(self._cut(height.z_um), height.pitch_um)
        self._preparation = Preparation(part, recipe, places.of_part(*self._window))
        self._wanted = _wanted(recipe)
        self._correlation = Autocorrelation(self._preparation.valid) if self._wants("spatial") else None
        whole_um = height.z_um[self._window]
        self.masked_share = float(np.isnan(whole_um).mean())
        self._beyond_share = 0.0 if beyond is None else float((beyond & np.isfinite(whole_um)).mean())
        self.left_out_share = 0.0 if self._left_out is None else self._beyond_share
        self._whole = None
        if self.left_out_share:
            kept = msgspec.structs.replace(recipe, keep_extrapolated=True, parameters=tuple(self._wanted))
            self._whole = ArealMeasurand(kept, height, places, extrapolated), height.z_um, part.z_um
        self._decay: Decay | None = None

    @property
    def valid(self) -> MaskArray:
        """Pixels of the region with a height: bool array."""
        return self._preparation.valid

    @property
    def without_sigma(self) -> frozenset[str]:
        """Parameters whose uncertainty the samples do not give."""
        shapes = (name for name, kind in AREAL.items() if kind.is_shape)
        return frozenset() if self._recipe.l_filter_um is not None else frozenset(shapes)

    def surface(self, z_um: Float32Array) -> HeightMap:
        """Return the scale-limited surface of a height map of shape (H, W)."""
        return HeightMap(self._preparation.apply(self._cut(z_um)), self._pitch_um)

    def _cut(self, z_um: Float32Array) -> Float32Array:
        """Return the region of a height map of shape (H, W), also NaN where slopes are extrapolated and not kept."""
        part = np.array(z_um[self._window], np.float32)
        if self._left_out is not None:
            part[self._left_out] = np.nan
        return part

    def kinds(self) -> Mapping[str, ParameterKind]:
        """Return the parameters of the recipe."""
        return self._wanted

    def values(self, z_um: Float32Array) -> Mapping[str, float]:
        """Return the parameters of a height map of shape (H, W)."""
        return self.parameters(self.surface(z_um).z_um)

    def parameters(self, z_um: Float32Array) -> dict[str, float]:
        """Return the parameters of a scale-limited surface."""
        found: dict[str, float] = {}
        if self._wants("height"):
            found |= height_parameters(z_um)
        if self._wants("hybrid"):
            found |= hybrid_parameters(z_um, self._pitch_um)
        if self._correlation is not None:
            found |= self._spatial(self._correlation.of(z_um))
        if self._wants("functional"):
            found |= functional_parameters(z_um)
        if self._recipe.smc_percent or self._recipe.smr_um:
            curve = MaterialRatioCurve.of(z_um)
            found |= {_smc(share): curve.height_um(share / 100.0) for share in self._recipe.smc_percent}
            found |= {_smr(height): 100.0 * curve.share(height) for height in self._recipe.smr_um}
        return found

    def warnings(self) -> Mapping[str, tuple[str, ...]]:
        """Return warnings about filter ends, mask, extrapolated slopes and field size."""
        every = []
        edge = self._preparation.edge_fraction()
        if edge > EDGE_FRACTION:
            every.append(f"{edge:.0%} of the area lies within half a filter's nesting index of a border or hole")
        if self.masked_share > MASKED_FRACTION:
            every.append(f"{self.masked_share:.0%} of the area is masked: the surface there may differ")
        if self._beyond_share > BEYOND_FRACTION:
            done = "it is kept"
            if self._left_out is not None:
                done = "it is left out, the effect is in the ±, and --keep-extrapolated keeps it"
            share = f"{self._beyond_share:.1%} of the area"
            every.append(f"extrapolated slopes: {share} has slopes beyond those of the calibration balls: {done}")
        return {"": tuple(every)} | self._spatial_warnings()

    def definition_sigmas(self) -> Mapping[str, float]:
        """Return the change of each parameter by the pixels left out for their slopes; none where all are kept."""
        if self._whole is None:
            return {}
        whole, height_um, part_um = self._whole
        kept, left = whole.values(height_um), self.parameters(self._preparation.apply(part_um))
        off = {name: abs(kept[name] - left[name]) for name in self._wanted}
        if "Std" in off:
            off["Std"] = min(off["Std"], 180.0 - off["Std"])
        return off

    def notes(self) -> tuple[str, ...]:
        """Return notes on region and filters."""
        found = []
        if self._recipe.region_um is None:
            found.append("region: the whole field, including untouched skin: set region_um to measure a part")
        s_um = self._recipe.s_filter_um
        if s_um is not None and s_um < FINEST_PX * self._pitch_um:
            found.append(f"S-filter: {s_um:g} µm is less than {FINEST_PX:g} pixels of {self._pitch_um:g} µm: no effect")
        return tuple(found)

    def _wants(self, group: str) -> bool:
        return not self._wanted.keys().isdisjoint(GROUPS[group])

    def _spatial(self, correlation: Float32Array) -> dict[str, float]:
        fallen = decay(correlation)
        if self._decay is None:
            self._decay = fallen  # of the height map, which is evaluated first
        return {
            "Sal": fallen.shortest_px * self._pitch_um,
            "Str": fallen.shortest_px / fallen.longest_px,
            "Std": texture_direction_deg(correlation) if "Std" in self._wanted else float("nan"),
        }

    def _spatial_warnings(self) -> dict[str, tuple[str, ...]]:
        if self._decay is None:
            return {}
        found: dict[str, tuple[str, ...]] = {}
        if not self._decay.reached:
            found["Str"] = ("upper limit: the autocorrelation does not fall to 0.2 in every direction of the field",)
        if self._decay.shortest_px > ISOTROPIC * self._decay.longest_px:
            found["Std"] = (f"the texture has no direction: Str is above {ISOTROPIC:g}",)
        if min(self._preparation.valid.shape) < MIN_LENGTHS * self._decay.shortest_px:
            found["Sal"] = (f"the field is narrower than {MIN_LENGTHS:g} times this length: it holds few features",)
        return found


def _wanted(recipe: Recipe) -> dict[str, ParameterKind]:
    names = [one for name in recipe.parameters for one in GROUPS.get(name, (name,))]
    found = {name: AREAL[name] for name in dict.fromkeys(names)}
    found |= {_smc(share): ParameterKind("µm") for share in recipe.smc_percent}
    return found | {_smr(height): ParameterKind("%") for height in recipe.smr_um}


def _smc(percent: float) -> str:
    return f"Smc({percent:g} %)"


def _smr(height_um: float) -> str:
    return f"Smr({height_um:g} µm)"


_KINDS: Final = (
    dict.fromkeys("aq", AMPLITUDE)
    | dict.fromkeys("zpvt", EXTREME)
    | {
        "sk": MOMENT,
        "ku": MOMENT,
        "dq": SLOPE,
        "Sm": ParameterKind("µm", 1.0),
    }
)


class ProfileMeasurand(Measurand):
    """A profile, levelled and filtered along its line, without the ends that the L-filter distorts.

    Parameters
    ----------
    table : the recipe's table
    height : the whole height map
    """

    def __init__(self, table: ProfileTable, height: HeightMap) -> None:
        _check_l_filter(table.l_filter_um, height.pitch_um)
        self.name = table.name
        self._table = table
        self._pitch_um = height.pitch_um
        self.line = Line(table.from_um, table.to_um, table.width_um)
        self.places_px = line_places(self.line, height.pitch_um)
        whole = self.trace(height.z_um)
        self.masked_share = whole.masked_share
        self._letter = "P" if table.l_filter_um is None else "R"
        self._sections, self._trim = self._evaluation(whole)
        found = self.values(height.z_um)
        self._shows_form = found[f"{self._letter}z"] < 2.0 * found[f"{self._letter}a"] * (1.0 - ROUNDING)

    def trace(self, z_um: Float32Array) -> Profile:
        """Return the profile of a surface of shape (H, W), levelled and filtered, over the whole line."""
        table = self._table
        raw = profile_along(z_um, self._pitch_um, self.line)
        heights = raw.z_um - _polynomial(raw, table.form_degree)
        if table.s_filter_um is not None:
            heights = profile_mean(heights, table.s_filter_um / self._pitch_um)
        if table.l_filter_um is not None:
            heights = heights - profile_mean(heights, table.l_filter_um / self._pitch_um)
        return Profile(heights, raw.step_um)

    def kinds(self) -> Mapping[str, ParameterKind]:
        """Return parameters of ISO 21920-2 by name."""
        return {self._letter + name: kind for name, kind in _KINDS.items()}

    def values(self, z_um: Float32Array) -> Mapping[str, float]:
        """Return the parameters over the evaluation length."""
        whole = self.trace(z_um)
        part = whole.z_um[self._trim : whole.z_um.size - self._trim]
        return profile_parameters(Profile(part, whole.step_um), self._sections, self._letter)

    def warnings(self) -> Mapping[str, tuple[str, ...]]:
        """Return warnings if the line is too short for its sections, or shows form and no roughness."""
        table = self._table
        if table.l_filter_um is None:
            return {}
        every = []
        if not self._trim or self._sections != table.sections:
            ends = "" if self._trim else " and includes the ends that the filter distorts"
            room = f"{self._sections} of {table.sections} sections of {table.l_filter_um:g} µm"
            every.append(f"the line has room for {room}{ends}")
        if self._shows_form:
            every.append("Rz is less than twice Ra: this is form that the filter leaves; raise form_degree")
        return {"": tuple(every)} if every else {}

    def _evaluation(self, whole: Profile) -> tuple[int, int]:
        """Return the number of sections, and of samples dropped at either end."""
        index_um = self._table.l_filter_um
        if index_um is None:
            return 1, 0
        length_um = whole.z_um.size * whole.step_um
        sections = min(self._table.sections, int(np.floor((length_um - index_um) / index_um + 1e-9)))
        if sections < 1:
            return 1, 0
        used = sections * index_um / whole.step_um
        return sections, max(round((whole.z_um.size - used) / 2.0), 1)


def _polynomial(profile: Profile, degree: int) -> Float64Array:
    """Return the least-squares polynomial of the valid samples: float64 array of shape (N,)."""
    valid = np.isfinite(profile.z_um)
    degree = min(degree, max(int(valid.sum()) - 1, 0))
    if not valid.any():
        return np.zeros(profile.z_um.size)
    place = np.linspace(-1.0, 1.0, profile.z_um.size)
    design = place[:, None] ** np.arange(degree + 1)
    solution = np.linalg.lstsq(design[valid], profile.z_um[valid], rcond=None)[0]
    return np.asarray(design @ solution, np.float64)
