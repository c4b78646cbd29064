"""Heights of a frame over its skin at rest, from slopes with the prior that the skin rests."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import cv2
import msgspec
import numpy as np

from device.balls.sphere import Viewpoint
from device.imaging.flat_field import LinearFrame
from device.inverse_map.skin_at_rest import CALM, MIN_RESTING, RESTING, RestEvidence
from device.surface import (
    Float32Array,
    GradientField,
    HeightMap,
    MaskArray,
    enlarged,
    levels_apart_um,
    pit_um,
    rest_height,
)
from hal.frame import RawFrame
from host_sync.denoising.slope_noise import BLUR_PX, without_blur
from host_sync.denoising.wavelet_shrinkage import SPLIT_PX
from host_sync.frame_checks.colour_check import check_datum
from host_sync.integration.integrate import IntegrationReport, integrate
from host_sync.integration.zero_level import NO_ZERO, Datum, find_datum, no_datum
from host_sync.johnson2009.model import integrate_forward_difference
from host_sync.kernels.jit import njit
from host_sync.kernels.parallel_rows import parallel_rows
from host_sync.reconstruction.slope_reading import SlopeReading, seen_elevation, seen_slopes
from host_sync.results.record import FrameCheck, SlopeNoise

if TYPE_CHECKING:
    from host_sync.calibration.calibrate import Calibration


@dataclass(frozen=True, slots=True, eq=False)
class RestingSlopes:
    """Slopes of a frame with the prior that the skin rests.

    read : at the skin's own places
    over_pixels : as they rise over the pixels of a camera nearby; `read` where the camera is far away
    prior : None where it does not apply
    viewpoint : of the camera; None where it is far away or not known
    pitch_um : distance of neighbouring pixels
    is_papers : estimated by the paper's method
    """

    read: GradientField
    over_pixels: GradientField
    prior: RestPrior | None
    viewpoint: Viewpoint | None
    pitch_um: float
    is_papers: bool

    @classmethod
    def of(cls, reading: SlopeReading, *, keep_noise: bool) -> RestingSlopes:
        """Return the slopes of a reading; with `keep_noise` no prior applies."""
        read, calibration, is_papers = reading.gradients, reading.first.calibration, reading.method == "paper"
        viewpoint = calibration.viewpoint
        seen = read if viewpoint is None else seen_slopes(read, viewpoint)
        prior = None if keep_noise or is_papers else RestPrior.of(seen, reading.rest, calibration.prior_sigma)
        if prior is not None:
            prior.apply(read)
            seen = read if viewpoint is None else seen_slopes(read, viewpoint)
        return cls(read, seen, prior, viewpoint, calibration.pitch_um, is_papers)

    def integrate(self, slopes: GradientField | None = None) -> tuple[HeightMap, IntegrationReport]:
        """Return the heights of slopes over pixels, by default its own, and the report of the solver."""
        solve = integrate_forward_difference if self.is_papers else integrate
        height, report = solve(self.over_pixels if slopes is None else slopes, self.pitch_um)
        if self.prior is not None:
            self.prior.level(height)
        return height, report

    def integrate_detail(self, raw: GradientField, height: HeightMap) -> tuple[GradientField, HeightMap]:
        """Return raw slopes with the same prior over the pixels of a known height map, and their heights."""
        over_pixels = raw if self.viewpoint is None else seen_slopes(raw, self.viewpoint, height)
        if self.prior is not None:
            self.prior.apply(over_pixels)
        return over_pixels, self.integrate(over_pixels)[0]

    def check(self) -> tuple[FrameCheck, ...]:
        """Return how much of the skin is at rest, where the prior applies."""
        if self.prior is None:
            return ()
        return (FrameCheck("skin at rest", "passed", self.prior.resting, MIN_RESTING, "of the field"),)


@dataclass(frozen=True, slots=True, eq=False)
class Heights:
    """Heights of a frame.

    height : zero at skin at rest
    gradients : the slopes that it was integrated from, of a camera nearby as they rise over its pixels
    datum : what the zero was taken from
    unlit : why the skin there is not lit as skin at rest is, a sentence each
    doubts : why the zero may be wrong, a sentence each
    """

    height: HeightMap
    gradients: GradientField
    datum: Datum
    unlit: list[str]
    doubts: list[str]

    @classmethod
    def of(cls, slopes: RestingSlopes, integrated: HeightMap, reading: SlopeReading) -> Heights:
        """Return integrated heights over their zero, as a camera nearby sees them."""
        first, gradients = reading.first, slopes.over_pixels
        at_rest = None if slopes.prior is None else slopes.prior.at_rest(integrated.z_um.shape)
        found = find_datum(integrated, gradients, at_rest=at_rest) if reading.has_rest else None
        datum = (found or no_datum(integrated, gradients)).at_rest(integrated, gradients)
        model = first.calibration.skin_at_rest
        gain_sigma = 0.0 if model is None else model.gain_sigma
        unlit = [] if datum.is_relative else check_datum(first.intensity, datum.skin, gain_sigma)
        height = datum.level(integrated)
        if slopes.viewpoint is not None:
            height = seen_elevation(height, slopes.viewpoint)
            gradients = seen_slopes(slopes.read, slopes.viewpoint, height, out=gradients)
        doubts = [NO_ZERO] if datum.is_relative else []
        if slopes.prior is not None:
            doubts += slopes.prior.doubts(integrated, None if datum.is_relative else height)
        return cls(height, gradients, datum, unlit, doubts)


def noise_of(frame: LinearFrame | RawFrame, calibration: Calibration) -> SlopeNoise | None:
    """Return the noise that shrinkage leaves in slopes of a frame; None where nothing is shrunk."""
    noise = calibration.slope_noise
    if noise is None or isinstance(frame, RawFrame) or frame.demosaiced:
        return noise
    # What a calibration of raw frames corrects of demosaicing is not missing from images that came with colours.
    return msgspec.structs.replace(noise, blur_px=min(noise.blur_px, BLUR_PX), raw_blur_px=0.0)


def sharpened(height: HeightMap, noise: SlopeNoise | None) -> HeightMap:
    """Return heights without the camera's blur."""
    return height if noise is None else without_blur(height, noise.blur_px)


# The two surfaces of a frame: raw and shrunk detail on the same long waves.
#
# Shrinkage takes noise out of detail, and with it what of the surface is no louder than noise. So roughness is measured
# on a second surface: the raw one's fine part on the shrunk one's coarse part. Both are the same where shrinkage does
# not reach, so that steps and radii do not depend on which of them is looked at.

CELL_PX: Final = 4
"""The Gaussian works on cells of so many pixels."""


def with_raw_detail(shrunk: HeightMap, raw: HeightMap) -> HeightMap:
    """Return the shrunk surface's long waves with the raw surface's detail; NaN where either has no height."""
    rows, columns = shrunk.z_um.shape
    difference, known = np.empty((rows, columns), np.float32), np.empty((rows, columns), np.float32)
    parallel_rows(_write_difference, shrunk.z_um.shape, shrunk.z_um, raw.z_um, difference, known)
    size = (max(columns // CELL_PX, 1), max(rows // CELL_PX, 1))
    total, weight = (
        cv2.GaussianBlur(cv2.resize(part, size, interpolation=cv2.INTER_AREA), (0, 0), SPLIT_PX / CELL_PX)
        for part in (difference, known)
    )
    coarse = cv2.resize(total / np.maximum(weight, np.float32(1e-6)), (columns, rows), interpolation=cv2.INTER_LINEAR)
    parallel_rows(_write_sum, shrunk.z_um.shape, shrunk.z_um, difference, known, coarse)
    return HeightMap(difference, shrunk.pitch_um)


def raw_slope_sigma(sigma: Float32Array, p: Float32Array, q: Float32Array, noise: SlopeNoise | None) -> Float32Array:
    """Return the standard uncertainty of the slopes of raw detail: float32 array of shape (H, W), NaN where invalid.

    sigma : the same of the shrunk surface, whose slopes are p and q
    """
    if noise is None:
        return sigma
    square = np.nan_to_num(np.minimum(p * p + q * q, np.float32(9.0)))
    return np.asarray(np.sqrt(sigma * sigma + noise.added_variance(square)), np.float32)


@njit(cache=True, nogil=True)
def _write_difference(
    shrunk: Float32Array, raw: Float32Array, difference: Float32Array, known: Float32Array, first: int, last: int
) -> None:
    for r in range(first, last):
        for c in range(shrunk.shape[1]):
            apart = raw[r, c] - shrunk[r, c]
            finite = np.isfinite(apart)
            difference[r, c] = apart if finite else np.float32(0.0)
            known[r, c] = np.float32(1.0) if finite else np.float32(0.0)


@njit(cache=True, nogil=True)
def _write_sum(
    shrunk: Float32Array, difference: Float32Array, known: Float32Array, coarse: Float32Array, first: int, last: int
) -> None:
    """Write the sum of shrunk heights and fine difference over the difference."""
    for r in range(first, last):
        for c in range(shrunk.shape[1]):
            z_um = shrunk[r, c] + difference[r, c] - coarse[r, c]
            difference[r, c] = z_um if known[r, c] > np.float32(0.0) else np.float32(np.nan)


# The prior that skin rests where light shows no slope, as weights and shrinkage of a frame's slopes and as its level.
#
# Skin at rest is level and lies at one height: what heights show there is error. Between an object and skin at rest the
# skin is free. Balls show slopes only where the skin touches them, high above rest, so that slopes of lower skin are
# extrapolated in elevation: near lights reach it at another angle, and the object shades it. On seven real sensors the
# slopes around a ball do not close (their mean over a ring is up to 0.2), those on it do. Information therefore rises
# with elevation, and what does not close is spread over the free skin instead of the object.

FREE_INFORMATION: Final = 0.1
"""Weight of a slope of free skin, relative to that of skin in contact."""

FREE_BELOW: Final = 0.2
CONTACT_ABOVE: Final = 0.6
"""Elevation as a fraction of the highest skin's, up to which skin is free and from which it touches the object."""

HIGHEST_PERCENT: Final = 99.5


@dataclass(frozen=True, slots=True, eq=False)
class RestPrior:
    """Shrinkage and weights of slopes, in cells over the field.

    kept : float32 array of shape (h, w), fraction of a slope that remains
    lit : bool array of shape (h, w), see `RestEvidence`
    weight : float32 array of shape (h, w), factor of a slope's weight
    slope_sigma : standard uncertainty of slopes
    """

    kept: Float32Array
    lit: MaskArray
    weight: Float32Array
    slope_sigma: float

    @classmethod
    def of(cls, gradients: GradientField, evidence: Sequence[RestEvidence], slope_sigma: float) -> RestPrior | None:
        """Return the prior of slopes (H, W) of a standard uncertainty; None where too little skin is at rest.

        evidence : of each group of lights; skin is at rest where all groups show it
        """
        if not evidence:
            return None
        kept = np.max([one.kept for one in evidence], axis=0)
        resting = kept < RESTING
        if resting.mean() < MIN_RESTING:
            return None
        even = cls(kept, np.all([one.lit for one in evidence], axis=0), np.ones(kept.shape, np.float32), slope_sigma)
        p, q = (kept * _mean_slopes(slope, gradients.valid, kept.shape) for slope in (gradients.p, gradients.q))
        height, _ = integrate(GradientField(p, q, np.ones(kept.shape, np.bool_), even.weight), 1.0)
        even.level(height)
        highest = float(np.percentile(height.z_um, HIGHEST_PERCENT))
        if highest <= 0.0:
            return even
        rise = np.clip((height.z_um / highest - FREE_BELOW) / (CONTACT_ABOVE - FREE_BELOW), 0.0, 1.0)
        contact = rise * rise * (3.0 - 2.0 * rise)
        information = np.where(kept < 0.5, 1.0, FREE_INFORMATION + (1.0 - FREE_INFORMATION) * contact)
        return cls(kept, even.lit, np.asarray(information, np.float32), slope_sigma)

    @property
    def resting(self) -> float:
        """Fraction of the field that is at rest."""
        return float((self.kept < RESTING).mean())

    def apply(self, gradients: GradientField) -> None:
        """Shrink and weight slopes (H, W) in place."""
        parallel_rows(self._apply_rows, gradients.p.shape, gradients.p, gradients.q, gradients.weight)

    def level(self, height: HeightMap) -> None:
        """Level heights in place, so that skin at rest is level and zero on its largest part."""
        error = rest_height(height, *self._skin, self.slope_sigma, self.weight)
        parallel_rows(_take_off_rows, height.z_um.shape, height.z_um, error)

    def doubts(self, levelled: HeightMap, height: HeightMap | None) -> list[str]:
        """Return why levelled heights and those over their zero (None without a zero) may be wrong, a clause each."""
        found = []
        apart_um = levels_apart_um(levelled, *self._skin, self.slope_sigma)
        if apart_um > 0.0:
            found.append(f"untouched skin lies {apart_um:.0f} µm apart in height: a flat face, or errors of slopes")
        depth_um = 0.0 if height is None else pit_um(height, self.lit.shape, self.slope_sigma)
        if depth_um > 0.0:
            found.append(f"skin lies {depth_um:.0f} µm below untouched skin: a recess, or errors of slopes")
        return found

    @property
    def _skin(self) -> tuple[MaskArray, MaskArray]:
        """Cells at rest, and calm ones."""
        return self.lit & (self.kept < RESTING), self.lit & (self.kept < CALM)

    def at_rest(self, shape: tuple[int, ...]) -> MaskArray:
        """True where skin is at rest: bool array of `shape` (H, W)."""
        return np.asarray(enlarged(self.kept, shape) < RESTING, np.bool_)

    def _apply_rows(self, p: Float32Array, q: Float32Array, weight: Float32Array, first: int, last: int) -> None:
        """Shrink and weight the rows `first` to `last` - 1."""
        rows = slice(first, last)
        kept, factor = (_rows_of(cells, p.shape, first, last) for cells in (self.kept, self.weight))
        p[rows] *= kept
        q[rows] *= kept
        weight[rows] *= factor


def _take_off_rows(height: Float32Array, cells: Float32Array, first: int, last: int) -> None:
    """Subtract cells over the field from the rows `first` to `last` - 1 of heights."""
    height[first:last] -= _rows_of(cells, height.shape, first, last)


def _mean_slopes(slope: Float32Array, valid: MaskArray, size: tuple[int, ...]) -> Float32Array:
    """Return the mean slopes of cells, shape `size`, where invalid pixels count as level."""
    known = slope if valid.all() else np.where(valid, slope, np.float32(0.0))
    return np.asarray(cv2.resize(known, size[::-1], interpolation=cv2.INTER_AREA), np.float32)


def _rows_of(cells: Float32Array, shape: tuple[int, ...], first: int, last: int) -> Float32Array:
    """Return rows `first` to `last` - 1 of cells enlarged to `shape`, bilinear between the middles of cells."""
    middle = (np.arange(first, last) + 0.5) * (cells.shape[0] / shape[0]) - 0.5
    middle = np.clip(middle, 0.0, cells.shape[0] - 1.0)
    upper = np.minimum(middle.astype(np.intp), max(cells.shape[0] - 2, 0))
    share = (middle - upper).astype(np.float32)[:, None]
    wide = cv2.resize(cells, (shape[1], cells.shape[0]), interpolation=cv2.INTER_LINEAR)
    below = np.minimum(upper + 1, cells.shape[0] - 1)
    return np.asarray(wide[upper] * (np.float32(1.0) - share) + wide[below] * share, np.float32)
