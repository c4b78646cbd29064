"""Slopes as lamps tell them that explain the balls of a calibration.

The inverse map reads every pixel; over cells of pixels, where lamps and coat are known as a whole, what it misreads is
found from the cells' own intensity and added to the slopes of every pixel, on level skin too. Elevation counts as the
lamps predict, and where a ray from a cell to a lamp meets the skin, its channel counts as far as they say: where it
counts for nothing the other two decide, and the surface around, in whose integration such slopes weigh little. Where
no skin is untouched the light tells how high all of it stands.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np

from device.imaging.flat_field import NormalizedImage
from device.surface.fields import Float32Array, Float64Array, GradientField, HeightMap, MaskArray
from host_sync.integration.datum import FLAT_SLOPES, height_of_rest_um
from host_sync.integration.integrate import Integrator
from host_sync.integration.zero_level import find_datum
from host_sync.kernels.cell_rows import cell_px
from host_sync.lights.lamp_model import FittedLamps
from host_sync.lights.lamp_slopes import INTENSITY_SIGMA
from host_sync.reconstruction.bent_cells import slopes_hidden_by_means
from host_sync.reconstruction.cell_correction import CellCorrection
from host_sync.reconstruction.elevation_correction import HIGHEST_SHARE, cell_means
from host_sync.reconstruction.lamp_cells import HiddenLights, LampCells, ToldSlopes
from host_sync.reconstruction.light_elevation import CLOSE_PX, DRIFT_ROUNDS, DRIFT_SHARE, Rise, RiseSearch

STEPS: Final = (2, 1, 1)
"""Steps of each round of the search, which begins where the last one ended; between them heights are found again."""

BEGIN_STEPS: Final = 6
"""Steps from the map's slopes, and from none, where all of the field stands high."""

SHADOW_ROUNDS: Final = 20
SETTLED_SLOPE: Final = 1e-3
"""At most so many rounds; they end once slopes where a light may be hidden move by no more, root mean square."""

FURTHER: Final = 0.75
"""Share of what the last round moved the surface by that is added to it: rounds that near their end from one side get
there in half as many, and do not swing past it."""

SETTLING_ROUNDS: Final = 5
SETTLED_SHARE: Final = 0.05
"""Rounds at one elevation, at most; they end when what the light tells of it changes by no more than this share."""

MIN_FLAT: Final = 0.9
"""Share of the field that is flat, from which on the light is asked whether all of it stands higher."""

MIN_RISE_PX: Final = 3.0
RISE_SIGMAS: Final = 6.0
"""Elevation, and times its uncertainty, from which on flat skin is no untouched skin."""

HIDDEN_SIGMA: Final = 0.12
"""Standard uncertainty of what slopes gain where a light is hidden, as a share of it, wrong all at once: on 57 objects
of nine rendered benches slopes of the surface, integrated with `SHADOW_WEIGHT`, were so far off there."""

SHADOW_WEIGHT: Final = 0.1
"""Weight in integration of slopes that two lights tell."""

SHADOW_CONFIDENCE: Final = 0.6
"""The same where their uncertainty is asked: it is 1.3 times that of other slopes, as rendered benches and the twin
show; integration counts on such slopes less, for they err all at once."""


def read_under_lamps(
    gradients: GradientField,
    image: NormalizedImage,
    lamps: FittedLamps,
    alone: Float32Array | None = None,
) -> CellCorrection:
    """What the slopes of an image (H, W), read as if every light arrived, gain.

    lamps : that explain the calibration's balls
    alone : what each channel shows under its own light alone, over the same of untouched skin, shape (H, W, 3); None
        where single lights were not taken
    """
    cell = cell_px(gradients.p.shape)
    p, q, known = cell_means(gradients.p, gradients.q, gradients.valid, cell)
    bend = slopes_hidden_by_means(gradients, (p.shape[0], p.shape[1]), cell)
    cells = LampCells.of(image, lamps.model, p.shape, cell, alone, bend)
    reading = _Reading(cells, Integrator(p.shape), np.stack([p, q], axis=-1).astype(np.float64) - bend, known)
    found = reading.begin()
    for steps in STEPS:
        found = reading.improved(found, steps)
        if found.is_level:
            break
    reading, found = reading.even_where_hidden(found)
    if found.has_zero:
        found = reading.settled(found)
    rise = None
    if reading.is_plate(found) or not found.has_zero:
        reading, found, rise = reading.raised(found)
    cells = reading.cells
    found = replace(found, slope=cells.linearised(found.slope, reading.known, found.z_px, found.lights))
    change = (found.slope - reading.read).astype(np.float32)
    p_change, q_change = (np.ascontiguousarray(change[..., axis]) for axis in (0, 1))
    share = np.float32(HIDDEN_SIGMA) * (found.shadow > 0.0)
    unsure = partial(cells.unsure, found.slope, found.z_px, lamps.folds, rise) if lamps.folds else None
    sigma = share * p_change, share * q_change
    left_alone = (~cells.faithful).astype(np.float32)
    return CellCorrection(
        p_change,
        q_change,
        *sigma,
        found.shadow,
        cell,
        SHADOW_WEIGHT,
        unsure,
        left_alone,
        has_rest=rise is None,
        confidence=SHADOW_CONFIDENCE,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Found:
    """What was found of a field of cells so far.

    slope : shape (h, w, 2)
    shadow : how much of each a hidden light leaves to the others, 0 to 1, shape (h, w)
    z_px : elevation that the slopes were found with, shape (h, w)
    has_zero : whether some skin is untouched
    lights : which may be hidden; None where that was not asked
    is_level : whether no skin is steep enough to be corrected
    """

    slope: Float64Array
    shadow: Float32Array
    z_px: Float32Array
    has_zero: bool = True
    lights: HiddenLights | None = None
    is_level: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class _Reading:
    """Cells, and slopes of their mean light as the inverse map reads them, shape (h, w, 2), where they are known."""

    cells: LampCells
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
        return _Found(told.slope, told.shadow, z_px, has_zero, told.lights)

    def even_where_hidden(self, found: _Found) -> tuple[_Reading, _Found]:
        """The same with nothing hidden by means where some of a light does not arrive: there pixels are misread."""
        if found.lights is None or not found.lights.dimmed.any():
            return self, found
        given_back = np.where(found.lights.dimmed[..., None], self.cells.bend, 0.0)
        cells = replace(self.cells, bend=self.cells.bend - given_back)
        return replace(self, cells=cells, read=self.read + given_back), replace(found, slope=found.slope + given_back)

    def settled(self, found: _Found) -> _Found:
        """What is found once slopes where a light may be hidden agree with the surface that they make.

        Two lights tell little of skin that turns away from the third, so that each round mends a part of what is left;
        what the last one moved the surface by is added in part once more.
        """
        if found.lights is None or not found.lights.hidden.any():
            return found
        told, last_px, datum = ToldSlopes(found.slope, found.shadow, found.lights), None, None
        count = np.sqrt(2.0 * found.lights.any_hidden.sum())
        for _ in range(SHADOW_ROUNDS):
            height, evenly = self._height(told.slope, told.shadow)
            datum = datum.of(height) if datum else find_datum(height, evenly)
            z_px = _known(datum.level(height))
            towards_px = z_px if last_px is None else z_px + np.float32(FURTHER) * (z_px - last_px)
            again, last_px = self.cells.told_again(self.read, told, z_px, towards_px), z_px
            moved = np.linalg.norm(again.slope - told.slope) / count
            told = again
            if moved < SETTLED_SLOPE:
                break
        return self.improved(replace(found, slope=told.slope, shadow=told.shadow), 1)

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
        slopes = [start if told is None else told.slope for start, told in zip(starts, found, strict=True)]
        from_map, from_none = (self.cells.missed(slope, nothing) for slope in slopes)
        gentler = np.linalg.norm(slopes[1], axis=-1) < np.linalg.norm(slopes[0], axis=-1)
        gentler &= from_none < from_map + INTENSITY_SIGMA
        return _Found(np.where(gentler[..., None], slopes[1], slopes[0]), nothing, nothing)

    def _elevation_px(self, found: _Found, risen_px: float | None) -> tuple[Float32Array, bool]:
        """Elevation of cells over untouched skin, float32 array of shape (h, w), and whether some skin is untouched.

        risen_px : of the median, where that is known otherwise
        """
        height, evenly = self._height(found.slope, found.shadow)
        if risen_px is None:
            datum = find_datum(height, evenly)
            return _known(datum.level(height)), not datum.is_relative
        middle_px = height_of_rest_um(height, self.known)
        return _known(HeightMap(height.z_um + np.float32(risen_px - middle_px), height.pitch_um)), False

    def _height(self, slope: Float64Array, shadow: Float32Array) -> tuple[HeightMap, GradientField]:
        """Heights in pixels, of cells as many pixels apart, and the slopes that they were integrated from."""
        mean = slope + self.cells.bend
        p, q = (np.ascontiguousarray(mean[..., axis], np.float32) for axis in (0, 1))
        step_px, known = float(self.cells.cell), self.known
        evenly = GradientField(p, q, known, known.astype(np.float32))
        weight = known * (np.float32(1.0) - np.float32(1.0 - SHADOW_WEIGHT) * shadow)
        height, _ = self.solver.integrate(replace(evenly, weight=weight.astype(np.float32)), step_px)
        return HeightMap(height.z_um, step_px), evenly


def _known(height: HeightMap) -> Float32Array:
    """Heights, zero where none is known."""
    return np.where(np.isfinite(height.z_um), height.z_um, np.float32(0.0)).astype(np.float32)
