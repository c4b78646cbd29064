"""Cells of a frame under lamps that explain the balls of a calibration: slopes where all lights arrive, and where not.

Where rays from a cell to a lamp meet the skin, or may, its light is that of the points of the lamp that are seen from
there, and the channel counts as far as it is as bright as they say; the slopes of such cells are known beforehand from
the surface around.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np

from device.imaging.flat_field import NormalizedImage
from device.surface.fields import Float32Array, Float64Array, HeightMap, MaskArray, surface_slopes
from host_sync.kernels.cell_rows import means_of_cells, middles_of_cells
from host_sync.lights.half_shadow import arriving_light
from host_sync.lights.lamp_model import POINT_SHARES, LampModel
from host_sync.lights.lamp_slopes import (
    INTENSITY_SIGMA,
    SURFACE_SIGMA,
    ChannelTrust,
    KnownBefore,
    LampSkin,
    move_past_hidden,
    move_towards,
)
from host_sync.lights.surroundings import Surroundings, faithful_cells
from host_sync.reconstruction.cell_correction import LEVEL, SlopePair, moved_cells, steepness, unsure_cells
from host_sync.reconstruction.hidden_lights import SET, arriving_share
from host_sync.reconstruction.light_elevation import Rise, rise_told_by_light

HIDDEN_STEPS: Final = 8
FREE_STEPS: Final = 3
"""Steps where a light may be hidden, which begin at the surface, and how many of them leave such lights out."""

AGAIN_STEPS: Final = 2
"""The same where such slopes are found again from a surface that hardly moves any more."""

APART: Final = (0.03, 0.08)
"""Intensity by which a channel is darker or brighter than predicted: from the first its weight falls, at the second it
is zero. Texture that cells average away changes intensity by less."""

HALF_SHADOW_SIGMA: Final = 0.35
"""Standard uncertainty of how much of a point's light arrives where half of it does."""

SEEN_POWER: Final = 4.0
"""A channel counts at most the seen share of its lamp to this power: what it tells in the dark is what other skin and
other lamps send there, of which less is known. With 2 near, low and short change by up to 0.02 µm."""

DIMMED: Final = 0.97
"""Share of a point's light below which a cell is dimmed."""

LINEAR_CELLS: Final = 6.0
"""Standard deviation of the Gaussian over slopes at which the light is linearised, cells: noise has to average out."""

LINEAR_SLOPE: Final = 0.015
"""Slopes that differ from those around by up to this much are linearised there; at twice as much, at themselves."""

HIDDEN_SURFACE_SIGMA: Final = 0.05
"""Standard uncertainty of the slopes of the surface that was found so far where a light is hidden: two lights at a low
angle tell little of skin that turns away from the third."""


@dataclass(frozen=True, slots=True, eq=False)
class HiddenLights:
    """What keeps lights from cells.

    hidden : whether a light may be hidden, bool array of shape (h, w, 3)
    arriving : how much of each is seen to arrive alone, or less where skin turns away from it: 0 to 1, float64 array of
        shape (h, w, 3)
    visible : how much arrives of each point of a lamp, as rays say, 0 to 1, float64 array of shape (h, w, 3, points)
    """

    hidden: MaskArray
    arriving: Float64Array
    visible: Float64Array

    @property
    def any_hidden(self) -> MaskArray:
        """Where any light may be: bool array of shape (h, w)."""
        return np.asarray(self.hidden.any(axis=-1))

    @property
    def dimmed(self) -> MaskArray:
        """Where some of a light does not arrive: bool array of shape (h, w)."""
        least = np.minimum(self.arriving, self.visible.min(axis=-1))
        return np.asarray((self.hidden & (least < DIMMED)).any(axis=-1))

    def weight(self, own: Float64Array, here: np.ndarray) -> Float64Array:
        """Weight of each channel of cells `here`, as far as what arrives of its lamp is known: shape (N, 3).

        own : share of its lamp in what each channel shows of untouched skin, shape (N, 3)
        """
        visible, shares = self.visible.reshape(-1, *self.visible.shape[2:])[here], np.array(POINT_SHARES)
        arriving = np.minimum((visible @ shares) ** SEEN_POWER, self.arriving.reshape(-1, 3)[here])
        doubt = HALF_SHADOW_SIGMA * own * (2.0 * np.sqrt(visible * (1.0 - visible)) @ shares)
        return np.asarray(np.minimum(arriving, 1.0 / (1.0 + (doubt / INTENSITY_SIGMA) ** 2)))


@dataclass(frozen=True, slots=True, eq=False)
class ToldSlopes:
    """Slopes that lamps tell.

    slope : shape (h, w, 2)
    shadow : how much of each a hidden light leaves to the others, 0 to 1, float32 array of shape (h, w)
    lights : which may be hidden
    """

    slope: Float64Array
    shadow: Float32Array
    lights: HiddenLights


@dataclass(frozen=True, slots=True, eq=False)
class LampCells:
    """A frame at the middles of cells under lamps that are known.

    intensity : float64 array of shape (h w, 3)
    skin : its places under the lamps
    cell : pixels along a cell
    arriving : how much each light arrives as seen under it alone, 0 to 1, float64 array of shape (h, w, 3)
    faithful : bool array of shape (h, w), False where a pixel is saturated or its reference dark
    bend : by how much mean slopes are steeper than those of the mean light, which all slopes here are: shape (h, w, 2)
    """

    intensity: Float64Array
    skin: LampSkin
    cell: int
    arriving: Float64Array
    faithful: MaskArray
    bend: Float64Array

    @classmethod
    def of(
        cls,
        image: NormalizedImage,
        model: LampModel,
        size: tuple[int, int],
        cell: int,
        alone: Float32Array | None,
        bend: Float64Array,
    ) -> LampCells:
        """The cells of an image (H, W) of `cell` x `cell` pixels, `size` of them."""
        row, column = middles_of_cells(size, cell)
        across, down = (axis.ravel() for axis in np.meshgrid(column, row))
        arriving = np.ones((*size, 3)) if alone is None else arriving_share(means_of_cells(alone, size, cell))
        intensity, faithful = faithful_cells(image, cell)
        skin = LampSkin.at(model, across, down, Surroundings.of_cells(intensity, faithful, cell))
        return cls(np.nan_to_num(intensity).reshape(-1, 3), skin, cell, arriving, faithful, bend)

    def slopes(
        self,
        read: Float64Array,
        slope: Float64Array,
        known: MaskArray,
        z_px: Float32Array,
        steps: int,
        *,
        everywhere: bool = False,
    ) -> ToldSlopes | None:
        """Slopes that the lamps tell; None where no skin is steep and no light may be hidden.

        read : as the inverse map does
        slope : where the search begins
        known : where slopes are
        z_px : elevation
        everywhere : also of level skin, which is untouched else
        """
        known = known & self.faithful
        lights = self._may_be_hidden(z_px, known)
        steep = (np.ones(known.shape) if everywhere else steepness(read)) * known
        lit = np.flatnonzero((steep > 0.0) & ~lights.any_hidden)
        dark = np.flatnonzero(lights.any_hidden)
        if not lit.size and not dark.size:
            return None
        surface, z = self._surface(z_px), z_px.ravel().astype(np.float64)
        found, trust = slope.reshape(-1, 2).copy(), np.ones(z.size)
        if lit.size:
            found[lit] = self._lit(found[lit], lit, surface[lit], z[lit], steps)
        if dark.size:
            found[dark], trust[dark] = self._dark(dark, surface[dark], z[dark], lights, HIDDEN_STEPS, FREE_STEPS)
        share = np.maximum(steep.ravel(), 1.0 - trust)[:, None]
        mixed = read.reshape(-1, 2) + share * (found - read.reshape(-1, 2))
        return ToldSlopes(mixed.reshape(read.shape), (1.0 - trust).reshape(z_px.shape).astype(np.float32), lights)

    def told_again(
        self, read: Float64Array, told: ToldSlopes, z_px: Float32Array, towards_px: Float32Array
    ) -> ToldSlopes:
        """The same slopes, found again where a light may be hidden.

        towards_px : elevation of the surface that such slopes are known from beforehand
        """
        dark = np.flatnonzero(told.lights.any_hidden)
        slope, shadow = told.slope.reshape(-1, 2).copy(), told.shadow.ravel().copy()
        surface, z = self._surface(towards_px)[dark], z_px.ravel()[dark].astype(np.float64)
        found, trust = self._dark(dark, surface, z, told.lights, AGAIN_STEPS, 0)
        plain = read.reshape(-1, 2)[dark]
        share = np.maximum(steepness(read).ravel()[dark], 1.0 - trust)[:, None]
        slope[dark], shadow[dark] = plain + share * (found - plain), 1.0 - trust
        return replace(told, slope=slope.reshape(read.shape), shadow=shadow.reshape(z_px.shape))

    def linearised(
        self, slope: Float64Array, known: MaskArray, z_px: Float32Array, lights: HiddenLights | None
    ) -> Float64Array:
        """Slopes (h, w, 2) that the lamps tell where all of them arrive, by a step from the slopes around.

        A rough coat is brightest along the view, with a crease there. Cells read one by one lean with their noise to
        the side of it where the light changes less; seen from a slope that their noise is not in they do not.

        lights : which may be hidden; None where none is
        """
        lit = known & self.faithful
        here = np.flatnonzero(lit if lights is None else lit & ~lights.any_hidden)
        around = cv2.GaussianBlur(slope, (0, 0), LINEAR_CELLS)
        apart = np.linalg.norm(slope - around, axis=-1, keepdims=True)
        begin = slope + np.clip(2.0 - apart / LINEAR_SLOPE, 0.0, 1.0) * (around - slope)
        found, z = slope.reshape(-1, 2).copy(), z_px.ravel()[here].astype(np.float64)
        found[here] = self._lit(begin.reshape(-1, 2)[here], here, self._surface(z_px)[here], z, 1)
        return found.reshape(slope.shape)

    def darker(self, levels: Float64Array) -> LampCells:
        """The same under lamps whose levels' logarithms (3,) are lower by so much."""
        return replace(self, intensity=self.intensity * np.exp(-levels))

    def missed(self, slope: Float64Array, z_px: Float32Array) -> Float64Array:
        """By how much slopes (h, w, 2) at elevations (h, w) miss the intensity, root of the channels' squares' sum."""
        shown = self.skin.shown(slope.reshape(-1, 2), z_px.ravel().astype(np.float64))
        return np.asarray(np.linalg.norm(self.intensity - shown, axis=1).reshape(z_px.shape))

    def rise(self, slope: Float64Array, z_px: Float32Array) -> Rise | None:
        """By how much all skin stands higher than it was taken to, as the light tells; None where it tells nothing."""
        here = np.flatnonzero(self.faithful & ~self._may_be_hidden(z_px, self.faithful).any_hidden)
        z = z_px.ravel()[here].astype(np.float64)
        return rise_told_by_light(self.skin.select(here), self.intensity[here], slope.reshape(-1, 2)[here], z)

    def unsure(
        self, slope: Float64Array, z_px: Float32Array, others: Sequence[LampModel], rise: Rise | None
    ) -> SlopePair:
        """By how much slopes under other lamps differ, and at an elevation that may be as well, so scaled that their
        squares add to a variance.
        """
        z = z_px.ravel().astype(np.float64)
        here = np.flatnonzero((np.linalg.norm(slope, axis=-1) > LEVEL[0]) | (rise is not None))
        skin, there = self.skin.select(here), slope.reshape(-1, 2)[here]
        shown, change = skin.shown_and_changes(there, z[here])
        less = [shown - skin.shown(there, z[here], other) for other in others]
        size = (z_px.shape[0], z_px.shape[1])
        by_fold = unsure_cells(here, size, change, less)
        if rise is None:
            return by_fold
        missing = [
            skin.shown(there, z[here] + z_px_apart) - shown + shown * np.array(levels)
            for z_px_apart, *levels in rise.deviations()
        ]
        by_rise = moved_cells(here, size, change, missing)
        p, q = (np.concatenate(parts) for parts in zip(by_fold, by_rise, strict=True))
        return p, q

    def _may_be_hidden(self, z_px: Float32Array, known: MaskArray) -> HiddenLights:
        """Which lights may be hidden where, of known skin."""
        light = arriving_light(z_px, self.cell, self.skin.model)
        hidden = (light.hidden | (self.arriving < 1.0)) & known[..., None]
        return HiddenLights(np.asarray(hidden), np.minimum(self.arriving, light.facing), light.visible)

    def _surface(self, z_px: Float32Array) -> Float64Array:
        """Slopes of a surface as its mean light shows them, shape (h w, 2)."""
        slopes = surface_slopes(HeightMap(z_px, float(self.cell)))
        return (np.stack(slopes, axis=-1).astype(np.float64) - self.bend).reshape(-1, 2)

    def _lit(
        self, slope: Float64Array, here: np.ndarray, surface: Float64Array, z_px: Float64Array, steps: int
    ) -> Float64Array:
        """Slopes of skin that all lights reach."""
        before = KnownBefore(surface, SURFACE_SIGMA)
        return move_towards(self.skin.select(here), self.intensity[here], slope, z_px, before, steps)

    def _dark(
        self,
        here: np.ndarray,
        surface: Float64Array,
        z_px: Float64Array,
        lights: HiddenLights,
        steps: int,
        free_steps: int,
    ) -> tuple[Float64Array, Float64Array]:
        """Slopes of skin that a light may not reach, and the weight of the least of its lights.

        steps, free_steps : from the surface, and how many of them, the first, leave such lights out
        """
        skin, before = self.skin.select(here), KnownBefore(surface, HIDDEN_SURFACE_SIGMA)
        counts = lights.weight(np.einsum("ncc->nc", skin.shares), here)
        trust = ChannelTrust(lights.hidden.reshape(-1, 3)[here], counts, APART, SET, free_steps)
        skin = replace(skin, visible=lights.visible.reshape(-1, *lights.visible.shape[2:])[here])
        slope, weight = move_past_hidden(skin, self.intensity[here], surface, z_px, before, steps, trust)
        return slope, weight.min(axis=1)
