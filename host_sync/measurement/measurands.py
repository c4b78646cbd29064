"""Measurands of a recipe: each turns a whole height map into named numbers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from device.surface import Float32Array, Float64Array, HeightMap
from host_sync.errors import MeasurementError
from host_sync.iso25178.areal_parameters import ParameterKind
from host_sync.measurement.circle_and_sphere import Circle, find_circle, fit_sphere
from host_sync.measurement.geometry import (
    Region,
    SkinPlaces,
    bend_deg,
    between_places,
    between_planes_deg,
    line_places,
    over_plane,
    pit_volumes,
    region_places,
)
from host_sync.measurement.recipe import AngleTable, CircleTable, DistanceTable, RadiusTable, StepTable, VolumeTable
from host_sync.profile.profile_line import Line, Profile, bilinear, profile_along
from host_sync.profile.step_height import (
    StepEdges,
    definition_sigma_um,
    find_edges,
    require_step,
    room_share,
    step_height_um,
)

_UM: Final = ParameterKind("µm")
_LENGTH: Final = ParameterKind("µm", 1.0)
_EXTREME: Final = ParameterKind("µm", noise_law="extreme")
_VOLUME: Final = ParameterKind("µm³", 2.0, noise_law="either")

MAX_OF_PLANE: Final = 0.35
"""Largest residual of a sphere, in that of a plane: a cylinder has 0.7, a ball with the skin around it 0.5."""

MAX_BEND: Final = 0.1
MIN_BEND_DEG: Final = 0.5
"""Halves of a face that lean apart by more than this share of the measured angle, and this angle, are no plane."""

OTHER_LEVELS: Final = (0.4, 0.6)
"""Levels that might be called the edge as well as half way: what they change is an uncertainty of the definition."""


class Measurand:
    """A place, line or region, and the quantities measured there.

    name : in the recipe
    masked_share : fraction without a height
    places_px : points all over it: float64 array of shape (N, 2), row and column, px
    """

    name: str
    masked_share: float
    places_px: Float64Array

    def kinds(self) -> Mapping[str, ParameterKind]:
        """Return units by name, in order."""
        raise NotImplementedError

    def values(self, z_um: Float32Array) -> Mapping[str, float]:
        """Return the numbers on a surface of shape (H, W), NaN where undefined; at least those of `kinds`."""
        raise NotImplementedError

    def warnings(self) -> Mapping[str, tuple[str, ...]]:
        """Return warnings by name, those of all numbers under an empty name; none where a subclass states none."""
        return {}

    def definition_sigmas(self) -> Mapping[str, float]:
        """Return the standard uncertainties by name that no sample of the height error shows, in the number's unit."""
        return {}


class FailedMeasurand(Measurand):
    """A measurand that the result does not show: its numbers are not defined, and its warning says why."""

    masked_share = 0.0

    def __init__(self, name: str, label: str, reason: str) -> None:
        self.name = name
        self._label = label
        self.reason = reason
        self.places_px = np.zeros((0, 2))

    def kinds(self) -> Mapping[str, ParameterKind]:
        """Return the one number that stands for all."""
        return {self._label: ParameterKind("")}

    def values(self, z_um: Float32Array) -> Mapping[str, float]:  # noqa: ARG002 - nothing is found on it
        """No value."""
        return {self._label: float("nan")}

    def warnings(self) -> Mapping[str, tuple[str, ...]]:
        """Return the reason."""
        return {"": (f"not measured: {self.reason}",)}


class StepMeasurand(Measurand):
    """A step, groove or ridge; the profile between the edges found on the height map is used of every sample."""

    def __init__(self, table: StepTable, height: HeightMap, places: SkinPlaces) -> None:
        self.name = table.name
        self.line = Line(table.from_um, table.to_um, table.width_um)
        self._pitch_um = height.pitch_um
        self._places = places
        self.profile = profile_along(height.z_um, height.pitch_um, self.line)
        self.places_px = line_places(self.line, height.pitch_um)
        self.masked_share = self.profile.masked_share
        self._are_found = not table.edges_um
        self.edges = StepEdges(table.kind, table.edges_um) if table.edges_um else find_edges(self.profile, table.kind)
        require_step(self.profile, self.edges, are_found=self._are_found)
        found = step_height_um(self.profile, self.edges)
        if table.kind == "ridge" and found < 0.0:
            raise MeasurementError("the line crosses a groove and no ridge: set kind, or draw it elsewhere")
        self._sign = -1.0 if found < 0.0 and table.kind == "groove" else 1.0
        self._label = "depth" if self._sign < 0.0 else "height"

    def kinds(self) -> Mapping[str, ParameterKind]:
        """Return the height, or depth of a groove; then where its edges lie along the line."""
        if self.edges.kind == "step":
            return {self._label: _UM, "edge at": _LENGTH}
        return {self._label: _UM, "first edge at": _LENGTH, "second edge at": _LENGTH, "width": _LENGTH}

    def values(self, z_um: Float32Array) -> Mapping[str, float]:
        """Return the step height or groove depth by ISO 5436-1, and the edges, µm."""
        profile = profile_along(z_um, self._pitch_um, self.line)
        height = {self._label: self._sign * step_height_um(profile, self.edges)}
        places = self._edges_of(profile)
        if len(places) == 1:
            return height | {"edge at": places[0]}
        return height | {
            "first edge at": places[0],
            "second edge at": places[1],
            "width": self._between_um(places[0], places[1], profile),
        }

    def warnings(self) -> Mapping[str, tuple[str, ...]]:
        """Return a line that is too short for the step's flank."""
        if self.edges.is_cut:
            words = (
                f"the line ends within three lengths of the flank at {self.edges.places_um[0]:.0f} µm, so that the "
                "height may be too small: lengthen it on both sides"
            )
            return {self._label: (words,)}
        share = room_share(self.profile, self.edges)
        if share >= 1.0:
            return {}
        words = (
            f"the line holds {share:.0%} of the profile that the flank of {self.edges.flank_um:.0f} µm needs next to "
            "the edge: lengthen it"
        )
        return {self._label: (words,)}

    def definition_sigmas(self) -> Mapping[str, float]:
        """Return how far the height depends on how much of the profile is used."""
        return {self._label: definition_sigma_um(self.profile, self.edges)}

    def _between_um(self, first_um: float, second_um: float, profile: Profile) -> float:
        """Return the distance on the skin of two places along the line."""
        known = np.isfinite(profile.z_um)
        along_um = np.array([first_um, second_um])
        z_um = np.interp(along_um, profile.along_um[known], profile.z_um[known])
        start, end = np.array(self.line.start_um, np.float64), np.array(self.line.end_um, np.float64)
        way = (end - start) / np.linalg.norm(end - start)
        first, second = self._places.of_seen(start + along_um[:, None] * way, z_um)
        return float(np.linalg.norm(second - first))

    def _edges_of(self, profile: Profile) -> tuple[float, ...]:
        if not self._are_found:
            return self.edges.places_um
        try:
            return find_edges(profile, self.edges.kind).places_um
        except MeasurementError:
            return tuple(float("nan") for _ in self.edges.places_um)


class DistanceMeasurand(Measurand):
    """Distances between two places."""

    def __init__(self, table: DistanceTable, height: HeightMap, places: SkinPlaces) -> None:
        self.name = table.name
        self._ends = np.array([table.from_um, table.to_um], np.float64)
        self._places = places
        self.places_px = line_places(Line(table.from_um, table.to_um), height.pitch_um)
        self.masked_share = 0.0
        self.values(height.z_um)  # a place outside the field is refused now

    def kinds(self) -> Mapping[str, ParameterKind]:
        """Return three lengths and the slope angle."""
        return {
            "along the skin": _LENGTH,
            "in height": _UM,
            "in space": _LENGTH,
            "slope angle": ParameterKind("°", -1.0),
        }

    def values(self, z_um: Float32Array) -> Mapping[str, float]:
        """Return distances and slope angle."""
        return between_places(z_um, self._places, *self._ends)


class AngleMeasurand(Measurand):
    """Angle between two faces."""

    def __init__(self, table: AngleTable, height: HeightMap, places: SkinPlaces) -> None:
        self.name = table.name
        self._regions = Region(*table.first_um), Region(*table.second_um)
        self._pitch_um = height.pitch_um
        self._first, self._second = (_places_of(region, height, places) for region in self._regions)
        self.masked_share = _masked(height, *self._regions)
        self.places_px = region_places(self._regions, height.pitch_um)
        self._angle_deg = self.values(height.z_um)["angle"]  # what cannot be measured is refused now
        cuts = (region.cut(height.z_um, height.pitch_um) for region in self._regions)
        self._bends_deg = [bend_deg(*one) for one in zip(cuts, (self._first, self._second), strict=True)]

    def kinds(self) -> Mapping[str, ParameterKind]:
        """Return one angle."""
        return {"angle": ParameterKind("°", -1.0)}

    def values(self, z_um: Float32Array) -> Mapping[str, float]:
        """Return the angle between the least-squares planes."""
        first, second = (region.cut(z_um, self._pitch_um) for region in self._regions)
        return {"angle": between_planes_deg(first, second, (self._first, self._second))}

    def warnings(self) -> Mapping[str, tuple[str, ...]]:
        """Return a region that is not flat."""
        words = tuple(
            f"the {name} region is not flat, its halves lean {bend:.2g}° apart: draw it inside one face"
            for name, bend in zip(("first", "second"), self._bends_deg, strict=True)
            if bend > max(MAX_BEND * self._angle_deg, MIN_BEND_DEG)
        )
        return {"angle": words} if words else {}

    def definition_sigmas(self) -> Mapping[str, float]:
        """Return how far the angle depends on which half of a region is used."""
        return {"angle": 0.5 * float(np.sqrt(np.nansum(np.square(self._bends_deg))))}


class RadiusMeasurand(Measurand):
    """Radius of a sphere."""

    def __init__(self, table: RadiusTable, height: HeightMap, places: SkinPlaces) -> None:
        self.name = table.name
        self._region = Region(*table.region_um)
        self._pitch_um = height.pitch_um
        self._places = _places_of(self._region, height, places)
        self.masked_share = _masked(height, self._region)
        self.places_px = region_places([self._region], height.pitch_um)
        surface_um = self._region.cut(height.z_um, height.pitch_um)
        self._start = fit_sphere(surface_um, self._places)
        flat_um = float(np.nanstd(over_plane(surface_um, np.isfinite(surface_um), self._places), dtype=np.float64))
        if self._start.residual_um > MAX_OF_PLANE * flat_um:
            raise MeasurementError(
                f"the region shows no sphere: the best one is {self._start.residual_um:.2g} µm off (RMS) and a plane "
                f"{flat_um:.2g} µm; draw the region inside the sphere"
            )

    def kinds(self) -> Mapping[str, ParameterKind]:
        """Return the radius, and RMS distance of the surface from the sphere."""
        return {"radius": ParameterKind("µm", 2.0), "residual": _UM}

    def values(self, z_um: Float32Array) -> Mapping[str, float]:
        """Return the least-squares sphere; the radius of a hollow is negative."""
        found = fit_sphere(self._region.cut(z_um, self._pitch_um), self._places, self._start)
        return {"radius": found.radius_um, "residual": found.residual_um}


class CircleMeasurand(Measurand):
    """A round edge: diameter, centre, roundness, and the step across it."""

    def __init__(self, table: CircleTable, height: HeightMap, places: SkinPlaces) -> None:
        self.name = table.name
        self._places = places
        self.found = find_circle(height.z_um, places, table.centre_um, table.radius_um)
        angle = np.linspace(0.0, 2.0 * np.pi, 128, endpoint=False)
        column_um, row_um, radius_um = self.found.grid
        circle = np.stack([np.sin(angle), np.cos(angle)], axis=-1) * radius_um
        self.places_px = (circle + np.array([row_um, column_um])) / height.pitch_um
        self.masked_share = 1.0 - float(bilinear(height.z_um, self.places_px[:, ::-1])[1].mean())
        others = [self._at(height.z_um, level).radius_um for level in OTHER_LEVELS]
        self._definition = 2.0 * float(np.std([self.found.radius_um, *others]))

    def kinds(self) -> Mapping[str, ParameterKind]:
        """Return four lengths along the skin, and a height."""
        along = dict.fromkeys(("diameter", "centre right", "centre down"), _LENGTH)
        return along | {"roundness": ParameterKind("µm", 1.0, noise_law="extreme"), "step": _UM}

    def values(self, z_um: Float32Array) -> Mapping[str, float]:
        """Return the circle of a height map of shape (H, W), µm."""
        found = self._at(z_um)
        return {
            "diameter": 2.0 * found.radius_um,
            "centre right": found.column_um,
            "centre down": found.row_um,
            "roundness": found.roundness_um,
            "step": found.step_um,
        }

    def warnings(self) -> Mapping[str, tuple[str, ...]]:
        """Return an edge that is not seen all around."""
        if self.found.share > 0.9:
            return {}
        return {"": (f"the edge is seen over {self.found.share:.0%} of the circle only",)}

    def definition_sigmas(self) -> Mapping[str, float]:
        """Return how far the diameter depends on which level is called the edge."""
        return {"diameter": self._definition}

    def _at(self, z_um: Float32Array, level: float = 0.5) -> Circle:
        column_um, row_um, radius_um = self.found.grid
        return find_circle(z_um, self._places, (column_um, row_um), radius_um, level)


class VolumeMeasurand(Measurand):
    """Volumes of a pit or a hill."""

    def __init__(self, table: VolumeTable, height: HeightMap, places: SkinPlaces) -> None:
        self.name = table.name
        self._region = Region(*table.region_um)
        self._pitch_um = height.pitch_um
        self._places = _places_of(self._region, height, places)
        self._border_px = max(round(table.border_um / height.pitch_um), 1)
        self.masked_share = _masked(height, self._region)
        self.places_px = region_places([self._region], height.pitch_um)
        if 2 * self._border_px >= min(self._region.cut(height.z_um, height.pitch_um).shape):
            raise MeasurementError(f"border_um: {table.border_um:g} µm leaves nothing inside the region: narrow it")
        self.values(height.z_um)  # what cannot be measured is refused now

    def kinds(self) -> Mapping[str, ParameterKind]:
        """Return two volumes, a depth and a height."""
        return {
            "void volume": _VOLUME,
            "material volume": _VOLUME,
            "largest depth": _EXTREME,
            "largest height": _EXTREME,
        }

    def values(self, z_um: Float32Array) -> Mapping[str, float]:
        """Return volumes below and above the plane through the border."""
        return pit_volumes(self._region.cut(z_um, self._pitch_um), self._places, self._border_px)

    def warnings(self) -> Mapping[str, tuple[str, ...]]:
        """Masked pixels are not counted."""
        if not self.masked_share:
            return {}
        missing = (f"{self.masked_share:.1%} of the region is masked and not counted: this is a lower limit",)
        return {"void volume": missing, "material volume": missing}


def _places_of(region: Region, height: HeightMap, places: SkinPlaces) -> SkinPlaces:
    """Return places of the pixels of a region."""
    rows, columns = height.z_um.shape
    return places.of_part(*region.pixels((rows, columns), height.pitch_um))


def _masked(height: HeightMap, *regions: Region) -> float:
    parts = [np.isnan(region.cut(height.z_um, height.pitch_um)).ravel() for region in regions]
    return float(np.concatenate(parts).mean())
