"""Measurands of a recipe: each turns a whole height map into named numbers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, Protocol

import numpy as np

from device.surface.fields import Float32Array, HeightMap
from host_sync.iso25178.areal_catalogue import ParameterKind
from host_sync.measurement.geometry import Region, between_places, between_planes_deg, pit_volumes
from host_sync.measurement.recipe import AngleTable, DistanceTable, RadiusTable, StepTable, VolumeTable
from host_sync.measurement.sphere import fit_sphere
from host_sync.profile.profile_line import Line, profile_along
from host_sync.profile.step_height import StepEdges, find_edges, step_height_um

_UM: Final = ParameterKind("µm")
_LENGTH: Final = ParameterKind("µm", 1.0)
_VOLUME: Final = ParameterKind("µm³", 2.0)


class Measurand(Protocol):
    """A place, line or region, and the quantities measured there."""

    @property
    def name(self) -> str:
        """Its name in the recipe."""
        ...

    @property
    def masked_share(self) -> float:
        """Fraction without a height."""
        ...

    def kinds(self) -> Mapping[str, ParameterKind]:
        """Units by name, in order."""
        ...

    def values(self, z_um: Float32Array) -> Mapping[str, float]:
        """The numbers on a surface of shape (H, W), NaN where undefined; at least those of `kinds`."""
        ...

    def warnings(self) -> Mapping[str, tuple[str, ...]]:
        """Warnings by name; those of all numbers under an empty name."""
        ...


class _WithoutWarnings:
    """A measurand without warnings of its own."""

    def warnings(self) -> Mapping[str, tuple[str, ...]]:
        return {}


class StepMeasurand(_WithoutWarnings):
    """A step, groove or ridge; its edges are found once, on the height map."""

    def __init__(self, table: StepTable, height: HeightMap) -> None:
        self.name = table.name
        self._line = Line(table.from_um, table.to_um, table.width_um)
        self._pitch_um = height.pitch_um
        profile = profile_along(height.z_um, height.pitch_um, self._line)
        self.masked_share = profile.masked_share
        self._edges = StepEdges(table.kind, table.edges_um) if table.edges_um else find_edges(profile, table.kind)
        found = step_height_um(profile, self._edges)
        self._sign = -1.0 if found < 0.0 and table.kind == "groove" else 1.0
        self._label = "depth" if self._sign < 0.0 else "height"

    def kinds(self) -> Mapping[str, ParameterKind]:
        """Height, or depth of a groove."""
        return {self._label: _UM}

    def values(self, z_um: Float32Array) -> Mapping[str, float]:
        """Step height or groove depth by ISO 5436-1."""
        profile = profile_along(z_um, self._pitch_um, self._line)
        return {self._label: self._sign * step_height_um(profile, self._edges)}


class DistanceMeasurand(_WithoutWarnings):
    """Distances between two places."""

    def __init__(self, table: DistanceTable, height: HeightMap) -> None:
        self.name = table.name
        self._ends = np.array([table.from_um, table.to_um], np.float64)
        self._pitch_um = height.pitch_um
        self.masked_share = 0.0

    def kinds(self) -> Mapping[str, ParameterKind]:
        """Three lengths and the slope angle."""
        return {
            "along the skin": _LENGTH,
            "in height": _UM,
            "in space": _LENGTH,
            "slope angle": ParameterKind("°", -1.0),
        }

    def values(self, z_um: Float32Array) -> Mapping[str, float]:
        """Distances and slope angle."""
        return between_places(z_um, self._pitch_um, *self._ends)


class AngleMeasurand(_WithoutWarnings):
    """Angle between two faces."""

    def __init__(self, table: AngleTable, height: HeightMap) -> None:
        self.name = table.name
        self._regions = Region(*table.first_um), Region(*table.second_um)
        self._pitch_um = height.pitch_um
        self.masked_share = _masked(height, *self._regions)

    def kinds(self) -> Mapping[str, ParameterKind]:
        """One angle."""
        return {"angle": ParameterKind("°", -1.0)}

    def values(self, z_um: Float32Array) -> Mapping[str, float]:
        """Angle between the least-squares planes."""
        first, second = (region.cut(z_um, self._pitch_um) for region in self._regions)
        return {"angle": between_planes_deg(first, second, self._pitch_um)}


class RadiusMeasurand(_WithoutWarnings):
    """Radius of a sphere."""

    def __init__(self, table: RadiusTable, height: HeightMap) -> None:
        self.name = table.name
        self._region = Region(*table.region_um)
        self._pitch_um = height.pitch_um
        self.masked_share = _masked(height, self._region)
        self._start = fit_sphere(self._region.cut(height.z_um, height.pitch_um), height.pitch_um)

    def kinds(self) -> Mapping[str, ParameterKind]:
        """Radius, and RMS distance of the surface from the sphere."""
        return {"radius": ParameterKind("µm", 2.0), "residual": _UM}

    def values(self, z_um: Float32Array) -> Mapping[str, float]:
        """Least-squares sphere; the radius of a hollow is negative."""
        found = fit_sphere(self._region.cut(z_um, self._pitch_um), self._pitch_um, self._start)
        return {"radius": found.radius_um, "residual": found.residual_um}


class VolumeMeasurand:
    """Volumes of a pit or a hill."""

    def __init__(self, table: VolumeTable, height: HeightMap) -> None:
        self.name = table.name
        self._region = Region(*table.region_um)
        self._pitch_um = height.pitch_um
        self._border_px = max(round(table.border_um / height.pitch_um), 1)
        self.masked_share = _masked(height, self._region)

    def kinds(self) -> Mapping[str, ParameterKind]:
        """Two volumes, a depth and a height."""
        return {"void volume": _VOLUME, "material volume": _VOLUME, "largest depth": _UM, "largest height": _UM}

    def values(self, z_um: Float32Array) -> Mapping[str, float]:
        """Volumes below and above the plane through the border."""
        return pit_volumes(self._region.cut(z_um, self._pitch_um), self._pitch_um, self._border_px)

    def warnings(self) -> Mapping[str, tuple[str, ...]]:
        """Masked pixels are not counted."""
        if not self.masked_share:
            return {}
        missing = (f"{self.masked_share:.1%} of the region is masked and not counted: this is a lower limit",)
        return {"void volume": missing, "material volume": missing}


def _masked(height: HeightMap, *regions: Region) -> float:
    parts = [np.isnan(region.cut(height.z_um, height.pitch_um)).ravel() for region in regions]
    return float(np.concatenate(parts).mean())
