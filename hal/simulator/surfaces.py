"""Closed-form surfaces that can be pressed into the twin's gel.

Every surface gives its height in mm over its own (x, y) in mm, highest point 0, NaN outside it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray


class Surface(Protocol):
    """A surface in closed form."""

    def height_mm(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        """Return the height (mm) at each (x, y), array of their shape: at most 0, NaN outside the surface."""
        ...


@dataclass(frozen=True, slots=True)
class Sphere:
    """The lower half of a ball, its lowest point at the origin."""

    radius_mm: float

    def height_mm(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        """Return the height (mm), NaN beyond the equator."""
        inside = self.radius_mm**2 - x_mm**2 - y_mm**2
        return np.where(inside >= 0.0, np.sqrt(np.maximum(inside, 0.0)) - self.radius_mm, np.nan)


@dataclass(frozen=True, slots=True)
class Leaning:
    """A surface that leans by `slope_x` (mm/mm), at most 0 within `reach_mm` of the origin."""

    surface: Surface
    slope_x: float
    reach_mm: float

    def height_mm(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        """Return the height (mm)."""
        lean = self.slope_x * x_mm - abs(self.slope_x) * self.reach_mm
        return np.asarray(self.surface.height_mm(x_mm, y_mm) + np.minimum(lean, 0.0))


@dataclass(frozen=True, slots=True)
class SphereGrid:
    """Balls on a square lattice of (2 reach + 1)² positions, one at the origin."""

    radius_mm: float
    spacing_mm: float
    reach: int

    def height_mm(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        """Return the height (mm), NaN between the balls."""
        across = x_mm - self.spacing_mm * np.clip(np.round(x_mm / self.spacing_mm), -self.reach, self.reach)
        along = y_mm - self.spacing_mm * np.clip(np.round(y_mm / self.spacing_mm), -self.reach, self.reach)
        return Sphere(self.radius_mm).height_mm(across, along)


EMPTY_CELLS = 0.4
"""Fraction of the cells of `Pebbles` without a ball, so that no two places of it look alike."""


@dataclass(frozen=True, slots=True)
class Pebbles:
    """Balls scattered over a plate larger than a field, one at a random place in each cell of a lattice or none."""

    radius_mm: float
    spacing_mm: float
    reach: int

    def height_mm(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        """Return the height (mm), NaN between the balls."""
        count = 2 * self.reach + 1
        free = 0.5 - self.radius_mm / self.spacing_mm
        random = np.random.default_rng(1)
        places = np.arange(-self.reach, self.reach + 1)
        lattice = np.stack(np.meshgrid(places, places)) + random.uniform(-free, free, (2, count, count))
        lattice[:, random.random((count, count)) < EMPTY_CELLS] = np.inf
        column, row = (
            np.clip(np.round(place / self.spacing_mm), -self.reach, self.reach).astype(np.intp) + self.reach
            for place in (x_mm, y_mm)
        )
        across = x_mm - self.spacing_mm * lattice[0][row, column]
        along = y_mm - self.spacing_mm * lattice[1][row, column]
        return Sphere(self.radius_mm).height_mm(across, along)


@dataclass(frozen=True, slots=True)
class Block:
    """A flat-faced block with rounded edges, into which the reliefs below are cut."""

    half_width_mm: float
    half_height_mm: float
    edge_radius_mm: float = 0.6

    def height_mm(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        """Return the height (mm) of the plain block, NaN beyond its sides."""
        beyond = np.hypot(
            np.maximum(np.abs(x_mm) - self.half_width_mm, 0.0), np.maximum(np.abs(y_mm) - self.half_height_mm, 0.0)
        )
        return Sphere(self.edge_radius_mm).height_mm(beyond, np.zeros_like(beyond))


@dataclass(frozen=True, slots=True)
class Plane:
    """A block's face, tilted by the given slopes (mm/mm)."""

    body: Block
    slope_x: float
    slope_y: float

    def height_mm(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        """Return the height (mm)."""
        top = abs(self.slope_x) * self.body.half_width_mm + abs(self.slope_y) * self.body.half_height_mm
        tilt = np.minimum(self.slope_x * x_mm + self.slope_y * y_mm - top, 0.0)
        return self.body.height_mm(x_mm, y_mm) + tilt


@dataclass(frozen=True, slots=True)
class Sinusoid:
    """A block with waves along x."""

    body: Block
    period_mm: float
    amplitude_mm: float

    def height_mm(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        """Return the height (mm)."""
        wave: FloatArray = self.amplitude_mm * (np.cos(2.0 * np.pi / self.period_mm * x_mm) - 1.0)
        return self.body.height_mm(x_mm, y_mm) + wave


@dataclass(frozen=True, slots=True)
class Groove:
    """A block with one groove along y: flat bottom of `width_mm`, flanks of `flank_mm`."""

    body: Block
    width_mm: float
    depth_mm: float
    flank_mm: float

    def height_mm(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        """Return the height (mm)."""
        wall = smooth_step((np.abs(x_mm) - self.width_mm / 2.0) / self.flank_mm)
        return self.body.height_mm(x_mm, y_mm) + self.depth_mm * (wall - 1.0)


@dataclass(frozen=True, slots=True)
class Step:
    """A block whose right half is higher by `rise_mm`, with a smooth flank of `flank_mm`."""

    body: Block
    rise_mm: float
    flank_mm: float

    def height_mm(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        """Return the height (mm)."""
        wall = smooth_step(x_mm / self.flank_mm + 0.5)
        return self.body.height_mm(x_mm, y_mm) + self.rise_mm * (wall - 1.0)


@dataclass(frozen=True, slots=True)
class Coin:
    """A coin: raised rim, a ring of beads, and a five-petalled flower in the middle."""

    radius_mm: float
    relief_mm: float
    flank_mm: float
    beads: int = 40

    def height_mm(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        """Return the height (mm), NaN beyond the edge."""
        radius, angle = np.hypot(x_mm, y_mm), np.arctan2(y_mm, x_mm)
        edge = Sphere(self.relief_mm * 2.0).height_mm(np.maximum(radius - self.radius_mm, 0.0), np.zeros_like(radius))
        rim = smooth_step((radius - 0.92 * self.radius_mm) / self.flank_mm)
        petals = self.radius_mm * (0.38 + 0.16 * np.cos(5.0 * angle))
        flower = 0.8 * smooth_step((petals - radius) / self.flank_mm)
        heart = -0.5 * smooth_step((0.10 * self.radius_mm - radius) / self.flank_mm)
        pitch = 2.0 * np.pi / self.beads
        sideways = radius * (np.mod(angle + pitch / 2.0, pitch) - pitch / 2.0)
        bead_mm = 0.035 * self.radius_mm
        bead = 0.7 * np.sqrt(np.maximum(1.0 - (sideways**2 + (radius - 0.8 * self.radius_mm) ** 2) / bead_mm**2, 0.0))
        relief: FloatArray = self.relief_mm * (rim + flower + heart + bead - 1.0)
        return edge + relief


@dataclass(frozen=True, slots=True)
class Texture:
    """A block with a fine weave whose period decreases from left to right."""

    body: Block
    amplitude_mm: float
    coarsest_mm: float
    finest_mm: float

    def height_mm(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        """Return the height (mm)."""
        position = np.clip(x_mm / (2.0 * self.body.half_width_mm) + 0.5, 0.0, 1.0)
        rate = np.log(self.finest_mm / self.coarsest_mm)
        # The phase is the integral of 2π / period, whose logarithm falls linearly across the block.
        phase = -2.0 * np.pi * 2.0 * self.body.half_width_mm / (self.coarsest_mm * rate) * np.exp(-rate * position)
        weave: FloatArray = np.cos(phase) * np.cos(2.0 * np.pi / self.coarsest_mm * y_mm)
        return self.body.height_mm(x_mm, y_mm) + self.amplitude_mm * (weave - 1.0)


def smooth_step(fraction: FloatArray) -> FloatArray:
    """0 below 0, 1 above 1, a smooth cubic between; array of the same shape."""
    inside = np.clip(fraction, 0.0, 1.0)
    return inside * inside * (3.0 - 2.0 * inside)


# Array types of the twin.

FloatArray: TypeAlias = NDArray[np.floating[Any]]
Float32Array: TypeAlias = NDArray[np.float32]
MaskArray: TypeAlias = NDArray[np.bool_]
