"""Slopes as lamps tell them that explain the balls of a calibration.

The inverse map reads every pixel; over cells of pixels, where lamps and coat are known as a whole, what it misreads is
found from the cells' own intensity and added to the slopes of every pixel. Elevation counts as the lamps predict, and
where a ray from a cell to a lamp meets the skin, its channel counts for nothing if it is as dark as that says: then the
other two decide, and the surface around, in whose integration such slopes weigh little. Where no skin is untouched the
light tells how high all of it stands.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from device.imaging.flat_field import NormalizedImage
from device.surface.fields import Float32Array, Float64Array, GradientField, HeightMap, MaskArray
from host_sync.integration.datum import FLAT_SLOPES, height_of_rest_um
from host_sync.integration.integrate import Integrator
from host_sync.integration.zero_level import find_datum
from host_sync.kernels.cell_rows import cell_px, means_of_cells, middles_of_cells
from host_sync.lights.known_lamps import KnownLamps
from host_sync.lights.lamp_model import FittedLamps, LampModel
from host_sync.lights.lamp_slopes import (
    INTENSITY_SIGMA,
    SURFACE_SIGMA,
    KnownBefore,
    LampSkin,
    move_towards,
)
from host_sync.lights.lit_skin import GRAZED, may_be_hidden
from host_sync.lights.surroundings import Surroundings, faithful_cells
from host_sync.reconstruction.cell_correction import (
    LEVEL,
    CellCorrection,
    SlopePair,
    moved_cells,
    steepness,
    unsure_cells,
)
from host_sync.reconstruction.elevation_correction import HIGHEST_SHARE, cell_means
from host_sync.reconstruction.hidden_lights import arriving_share, clearance, trust_in
from host_sync.reconstruction.light_elevation import (
    CLOSE_PX,
    DRIFT_ROUNDS,
    DRIFT_SHARE,
    Rise,
    RiseSearch,
    rise_told_by_light,
)

STEPS: Final = (2, 1, 1)
"""Steps of each round of the search, which begins where the last one ended; between them heights are found again."""

BEGIN_STEPS: Final = 6
"""Steps from the map's slopes, and from none, where all of the field stands high."""

SETTLING_ROUNDS: Final = 5
SETTLED_SHARE: Final = 0.05
"""Rounds at one elevation, at most; they end when what the light tells of it changes by no more than this share."""

HIDDEN_STEPS: Final = 8
FREE_STEPS: Final = 3
"""Steps where a light may be hidden, which begin at the surface, and how many of them leave such lights out."""

MIN_FLAT: Final = 0.9
"""Share of the field that is flat, from which on the light is asked whether all of it stands higher."""

MIN_RISE_PX: Final = 3.0
RISE_SIGMAS: Final = 6.0
"""Elevation, and times its uncertainty, from which on flat skin is no untouched skin."""

HIDDEN_SIGMA: Final = 0.2
"""Standard uncertainty of what slopes gain where a light is hidden, as a share of it, wrong all at once: of 56 rendered
objects the gain was off by 0.01 to 0.5 of it, 0.21 root mean square.
"""

DARKER: Final = (0.02, 0.06)
"""Intensity by which a channel is darker than predicted: from the first its weight falls, at the second it is zero."""

HIDDEN_SURFACE_SIGMA: Final = 0.05
"""Standard uncertainty of the slopes of the surface that was found so far where a light is hidden: two lights at a low
angle tell little of skin that turns away from the third."""

SHADOW_WEIGHT: Final = 0.1
"""Weight in integration of slopes that two lights tell."""


def read_under_lamps(
    gradients: GradientField,
    image: NormalizedImage,
    lamps: FittedLamps,
    alone: Float32Array | None = None,
) -> CellCorrection | None:
    """What the slopes of an image (H, W), read as if every light arrived, gain; None where all is level and at rest.

    lamps : that explain the calibration's balls
    alone : what each channel shows under its own light alone, over the same of untouched skin, shape (H, W, 3); None
        where single lights were not taken
    """
    cell = cell_px(gradients.p.shape)
    p, q, known = cell_means(gradients.p, gradients.q, gradients.valid, cell)
    cells = _Cells.of(image, lamps.model, p.shape, cell, alone)
    reading = _Reading(cells, Integrator(p.shape), np.stack([p, q], axis=-1).astype(np.float64), known)
    found = reading.begin()
    for steps in STEPS:
        found = reading.improved(found, steps)
        if found.is_level:
            break
    rise, is_plate = None, reading.is_plate(found)
    if found.is_level and not is_plate:
        return None
    if is_plate or not found.has_zero:
        reading, found, rise = reading.raised(found)
        cells = reading.cells
    change = (found.slope - reading.read).astype(np.float32)
    p_change, q_change = (np.ascontiguousarray(change[..., axis]) for axis in (0, 1))
    share = np.float32(HIDDEN_SIGMA) * (found.shadow > 0.0)
    unsure = cells.unsure(found.slope, found.z_px, lamps.folds, rise) if lamps.folds else None
    sigma = share * p_change, share * q_change
    left_alone = (~cells.faithful).astype(np.float32)
    rest = rise is None
    return CellCorrection(p_change, q_change, *sigma, found.shadow, cell, SHADOW_WEIGHT, unsure, left_alone, rest)


@dataclass(frozen=True, slots=True, eq=False)
class _Found:
    """What was found of a field of cells so far.

    slope : shape (h, w, 2)
    shadow : how much of each a hidden light leaves to the others, 0 to 1, shape (h, w)
    z_px : elevation that the slopes were found with, shape (h, w)
    has_zero : whether some skin is untouched
    is_level : whether no skin is steep enough to be corrected
    """

    slope: Float64Array
    shadow: Float32Array
    z_px: Float32Array
    has_zero: bool = True
    is_level: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class _Reading:
    """Cells, and slopes as the inverse map reads them, shape (h, w, 2), where they are known."""

    cells: _Cells
    solver: Integrator
    read: Float64Array
    known: MaskArray

    def begin(self) -> _Found:
        """Nothing found yet."""
        nothing = np.zeros(self.known.shape, np.float32)
        return _Found(self.read, nothing, nothing)

    def improved(self, found: _Found, steps: int, risen_px: float | None = None) -> _Found:
        """What is found next from what was found.

        risen_px : elevation of the middle of all heights where no skin is untouched; None where that is not asked
        """
        z_px, has_zero = self._elevation_px(found, risen_px)
        told = self.cells.slopes(self.read, found.slope, self.known, z_px, steps, everywhere=risen_px is not None)
        if told is None:
            return _Found(found.slope, found.shadow, z_px, has_zero, is_level=True)
        return _Found(*told, z_px, has_zero)

    def is_plate(self, found: _Found) -> bool:
        """Whether skin that is flat nearly everywhere lies on a plate under the whole field, as the light tells."""
        steep = np.linalg.norm(found.slope, axis=-1)[self.known] > FLAT_SLOPES[-1]
        rise = None if not steep.size or steep.mean() > 1.0 - MIN_FLAT else self.cells.rise(found.slope, found.z_px)
        return rise is not None and abs(rise.z_px) > max(MIN_RISE_PX, RISE_SIGMAS * rise.sigma_px)

    def raised(self, found: _Found) -> tuple[_Reading, _Found, Rise | None]:
        """What is found at the elevation and the brightness of lamps that the light tells, and what is left of these;
        None where it tells none.
        """
        highest_px = HIGHEST_SHARE * self.cells.skin.model.shape[1] * float(self.cells.skin.model.position[:, 2].min())
        search, there, reading = RiseSearch(highest_px), self._begin_again(), self
        while True:
            there, rise = self._settled(there, search.z_px)
            if rise is None:
                return self, found, None
            if not search.goes_on(rise.z_px):
                break
        risen_px = search.z_px
        for _ in range(DRIFT_ROUNDS if rise.drift.any() else 0):
            risen_px = float(np.clip(risen_px + DRIFT_SHARE * rise.z_px, -highest_px, highest_px))
            reading = replace(reading, cells=reading.cells.darker(DRIFT_SHARE * rise.levels))
            there = reading.improved(there, STEPS[0], risen_px)
            rise = reading.cells.rise(there.slope, there.z_px) or rise
        return reading, there, rise

    def _settled(self, found: _Found, risen_px: float) -> tuple[_Found, Rise | None]:
        """What is found at an elevation, and what the light tells then, once shape and slopes agree with each other:
        until then the light tells of the elevation before.
        """
        before_px = np.inf
        for _ in range(SETTLING_ROUNDS):
            found = self.improved(found, STEPS[0], risen_px)
            rise = self.cells.rise(found.slope, found.z_px)
            if rise is None or abs(rise.z_px - before_px) < CLOSE_PX + SETTLED_SHARE * abs(rise.z_px):
                break
            before_px = rise.z_px
        return found, rise

    def _begin_again(self) -> _Found:
        """Slopes of a level field from the map's, or from none where that ends gentler and explains a cell as well.

        What the map reads of skin that stands high near a lamp may be far from what it was taught.
        """
        nothing = np.zeros(self.known.shape, np.float32)
        starts = self.read, np.zeros_like(self.read)
        found = [
            self.cells.slopes(self.read, start, self.known, nothing, BEGIN_STEPS, everywhere=True) for start in starts
        ]
        slopes = [start if told is None else told[0] for start, told in zip(starts, found, strict=True)]
        from_map, from_none = (self.cells.missed(slope, nothing) for slope in slopes)
        gentler = np.linalg.norm(slopes[1], axis=-1) < np.linalg.norm(slopes[0], axis=-1)
        gentler &= from_none < from_map + INTENSITY_SIGMA
        return _Found(np.where(gentler[..., None], slopes[1], slopes[0]), nothing, nothing)

    def _elevation_px(self, found: _Found, risen_px: float | None) -> tuple[Float32Array, bool]:
        """Elevation of cells over untouched skin, float32 array of shape (h, w), and whether some skin is untouched.

        risen_px : of the median, where that is known otherwise
        """
        p, q = (np.ascontiguousarray(found.slope[..., axis], np.float32) for axis in (0, 1))
        step_px, known = float(self.cells.cell), self.known
        evenly = GradientField(p, q, known, known.astype(np.float32))
        weight = known * (np.float32(1.0) - np.float32(1.0 - SHADOW_WEIGHT) * found.shadow)
        height, _ = self.solver.integrate(replace(evenly, weight=weight.astype(np.float32)), step_px)
        in_px = HeightMap(height.z_um, step_px)
        if risen_px is None:
            datum = find_datum(in_px, evenly)
            level, has_zero = datum.level(in_px).z_um, not datum.is_relative
        else:
            middle_px = height_of_rest_um(in_px, known)
            level, has_zero = in_px.z_um + np.float32(risen_px - middle_px), False
        return np.where(np.isfinite(level), level, np.float32(0.0)).astype(np.float32), has_zero


@dataclass(frozen=True, slots=True, eq=False)
class _Cells:
    """A frame at the middles of cells.

    intensity : float64 array of shape (h w, 3)
    skin : its places under the lamps
    cell : pixels along a cell
    arriving : how much each light arrives as seen under it alone, 0 to 1, float64 array of shape (h, w, 3)
    faithful : bool array of shape (h, w), False where a pixel is saturated or its reference dark
    """

    intensity: Float64Array
    skin: LampSkin
    cell: int
    arriving: Float64Array
    faithful: MaskArray

    @classmethod
    def of(
        cls, image: NormalizedImage, model: LampModel, size: tuple[int, int], cell: int, alone: Float32Array | None
    ) -> _Cells:
        """The cells of an image (H, W) of `cell` x `cell` pixels, `size` of them."""
        row, column = middles_of_cells(size, cell)
        across, down = (axis.ravel() for axis in np.meshgrid(column, row))
        arriving = np.ones((*size, 3)) if alone is None else arriving_share(means_of_cells(alone, size, cell))
        intensity, faithful = faithful_cells(image, cell)
        skin = LampSkin.at(model, across, down, Surroundings.of_cells(intensity, faithful, cell))
        return cls(np.nan_to_num(intensity).reshape(-1, 3), skin, cell, arriving, faithful)

    def slopes(
        self,
        read: Float64Array,
        slope: Float64Array,
        known: MaskArray,
        z_px: Float32Array,
        steps: int,
        *,
        everywhere: bool = False,
    ) -> tuple[Float64Array, Float32Array] | None:
        """Slopes (h, w, 2) that the lamps tell, and how much of each a hidden light leaves to the others, 0 to 1.

        read : as the inverse map does
        slope : where the search begins
        known : where slopes are
        z_px : elevation
        everywhere : also of level skin, which is untouched else
        """
        known = known & self.faithful
        hidden, arriving = self._may_be_hidden(z_px)
        hidden &= known[..., None]
        steep = (np.ones(known.shape) if everywhere else steepness(read)) * known
        lit, dark = (np.flatnonzero(part) for part in ((steep > 0.0) & ~hidden.any(axis=-1), hidden.any(axis=-1)))
        if not lit.size and not dark.size:
            return None
        surface = np.stack([np.gradient(z_px, self.cell, axis=axis) for axis in (1, 0)], axis=-1).astype(np.float64)
        found, trust = slope.reshape(-1, 2).copy(), np.ones(z_px.size)
        self._solve_lit(found, lit, surface.reshape(-1, 2), z_px.ravel(), steps)
        lights = hidden.reshape(-1, 3), arriving.reshape(-1, 3)
        self._solve_dark(found, trust, dark, surface.reshape(-1, 2), z_px.ravel(), *lights)
        share = np.maximum(steep.ravel(), 1.0 - trust)[:, None]
        mixed = read.reshape(-1, 2) + share * (found - read.reshape(-1, 2))
        return mixed.reshape(read.shape), (1.0 - trust).reshape(z_px.shape).astype(np.float32)

    def darker(self, levels: Float64Array) -> _Cells:
        """The same under lamps whose levels' logarithms (3,) are lower by so much."""
        return replace(self, intensity=self.intensity * np.exp(-levels))

    def missed(self, slope: Float64Array, z_px: Float32Array) -> Float64Array:
        """By how much slopes (h, w, 2) at elevations (h, w) miss the intensity, root of the channels' squares' sum."""
        shown = self.skin.shown(slope.reshape(-1, 2), z_px.ravel().astype(np.float64))
        return np.asarray(np.linalg.norm(self.intensity - shown, axis=1).reshape(z_px.shape))

    def rise(self, slope: Float64Array, z_px: Float32Array) -> Rise | None:
        """By how much all skin stands higher than it was taken to, as the light tells; None where it tells nothing."""
        hidden, _ = self._may_be_hidden(z_px)
        here = np.flatnonzero(self.faithful & ~hidden.any(axis=-1))
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

    def _may_be_hidden(self, z_px: Float32Array) -> tuple[MaskArray, Float64Array]:
        """Which lights may be hidden where, bool array of shape (h, w, 3), and how much each arrives at most."""
        model = self.skin.model
        slants = KnownLamps(model.position * model.shape[1]).slants(z_px, self.cell, model.shape)
        clear = np.stack([clearance(z_px, self.cell, slants[..., lamp, :]) for lamp in range(3)], axis=-1)
        level = 1.0 / np.maximum(np.linalg.norm(slants, axis=-1), 1e-3)
        hidden = may_be_hidden(clear, level) | (self.arriving < 1.0)
        passes = np.clip((clear - GRAZED[0]) / (GRAZED[1] - GRAZED[0]), 0.0, 1.0)
        return np.asarray(hidden), np.minimum(self.arriving, passes)

    def _solve_lit(
        self, found: Float64Array, here: np.ndarray, surface: Float64Array, z_px: Float32Array, steps: int
    ) -> None:
        """Write slopes of skin that all lights reach."""
        if not here.size:
            return
        skin, z = self.skin.select(here), z_px[here].astype(np.float64)
        before = KnownBefore(surface[here], SURFACE_SIGMA)
        slope = found[here]
        for _ in range(steps):
            slope = move_towards(skin, self.intensity[here], slope, z, before)
        found[here] = slope

    def _solve_dark(
        self,
        found: Float64Array,
        trust: Float64Array,
        here: np.ndarray,
        surface: Float64Array,
        z_px: Float32Array,
        hidden: MaskArray,
        arriving: Float64Array,
    ) -> None:
        """Write slopes of skin that a light may not reach, and the weight of the least of its lights.

        hidden, arriving : of each light, whether it may be, and how much it arrives at most, shape (h w, 3)
        """
        if not here.size:
            return
        skin, seen, z = self.skin.select(here), self.intensity[here], z_px[here].astype(np.float64)
        before, slope = KnownBefore(surface[here], HIDDEN_SURFACE_SIGMA), surface[here]
        weight = np.where(hidden[here], 0.0, 1.0)
        for step in range(HIDDEN_STEPS):
            shown = skin.shown_and_changes(slope, z)
            if step >= FREE_STEPS:
                weight = np.where(hidden[here], np.minimum(arriving[here], trust_in(seen, shown[0], DARKER)), 1.0)
            slope = move_towards(skin, seen, slope, z, before, weight, shown)
        found[here], trust[here] = slope, weight.min(axis=1)
