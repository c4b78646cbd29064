"""Profile parameters along a line, as a measurand."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from device.quick_look.solver import MIN_CUTOFF_PX, ROUNDING
from device.surface import Float32Array, Float64Array, HeightMap
from host_sync.errors import MeasurementError
from host_sync.filters.gaussian_regression import profile_mean
from host_sync.iso25178.areal_parameters import AMPLITUDE, SLOPE, ParameterKind
from host_sync.measurement.geometry import line_places
from host_sync.measurement.recipe import ProfileTable
from host_sync.profile.profile_line import Line, Profile, profile_along, profile_parameters

_NUMBER: Final = ParameterKind("")
_KINDS: Final = dict.fromkeys(("a", "q", "z", "p", "v", "t"), AMPLITUDE) | {
    "sk": _NUMBER,
    "ku": _NUMBER,
    "dq": SLOPE,
    "Sm": ParameterKind("µm", 1.0),
}


class ProfileMeasurand:
    """A profile, levelled and filtered along its line, without the ends that the L-filter distorts.

    Parameters
    ----------
    table : the recipe's table
    height : the whole height map
    """

    def __init__(self, table: ProfileTable, height: HeightMap) -> None:
        if table.l_filter_um is not None and table.l_filter_um < MIN_CUTOFF_PX * height.pitch_um:
            raise MeasurementError(
                f"l_filter_um: {table.l_filter_um:g} µm holds fewer than {MIN_CUTOFF_PX:g} pixels of "
                f"{height.pitch_um:g} µm: choose a longer one"
            )
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

    def definition_sigmas(self) -> Mapping[str, float]:
        """None: the standard defines every parameter."""
        return {}

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
