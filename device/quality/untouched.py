"""What untouched skin shows: present light levels, their drift since calibration, defects of the gel.

Light levels: the field is cut into blocks. A block of untouched skin differs from the reference by one factor per
channel and by sensor noise; shading spreads more widely. Where enough blocks agree on the three factors, those are the
light levels. Otherwise the frame gives no evidence, because pressed skin changes intensity as a weak light does.

A flat object over the whole field looks much like untouched skin. Two properties reveal it: near lights reach raised
skin unevenly, so that blocks disagree; and a tilt brightens one side as much as it darkens the other, so that the three
changes add up to zero.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from device.imaging.flat_field import LinearFrame, NormalizedImage
from device.quality.thresholds import DEFECT_CONTRAST
from device.surface.fields import Float32Array, MaskArray

BLOCKS_ACROSS: Final = 24
AGREEING: Final = 0.006
NOISE_SIGMAS: Final = 3.0
AGREEING_PER_CHANGE: Final = 0.12
"""Inlier tolerance of a block: AGREEING + NOISE_SIGMAS · standard error + AGREEING_PER_CHANGE · |change|; the last term
covers filter crosstalk, which varies over the field."""

MIN_FRACTION: Final = 0.33
"""Minimum fraction of blocks that must agree."""

WHOLE_FRACTION: Final = 0.9
"""Fraction of agreeing blocks from which the whole field is untouched."""

NOISIER: Final = 1.5
SPREAD_FLOOR: Final = 0.003
"""A block is shaded if its spread exceeds NOISIER · its spread in the reference + SPREAD_FLOOR."""

TILT_BALANCE: Final = 0.35
MIN_TILT_CHANGE: Final = 0.008
"""Changes above MIN_TILT_CHANGE whose sum is below TILT_BALANCE · the largest come from a tilt, not from lights."""

MAX_STEP: Final = 0.012
"""Largest light change accepted from a partly touched frame; larger changes need a fully untouched one."""

NOISE_BLUR_PX: Final = 1.0
SURROUNDINGS_PX: Final = 8.0
"""Standard deviations of the Gaussians that average a spot and its surroundings, in quick-look pixels."""


@dataclass(frozen=True, slots=True)
class UntouchedRegion:
    """Untouched skin found in a frame.

    levels : of the R, G and B channel relative to the reference
    fraction : of the field's blocks that agree on them
    pattern : rms deviation of those blocks from the reference's pattern after removal of the levels
    """

    levels: tuple[float, float, float]
    fraction: float
    pattern: float

    @property
    def is_whole(self) -> bool:
        """Whether the whole field is untouched."""
        return self.fraction >= WHOLE_FRACTION

    @property
    def is_tilt(self) -> bool:
        """Whether the changes look like a tilt of the whole field rather than a change of the lights."""
        changes = [level - 1.0 for level in self.levels]
        largest = max(abs(change) for change in changes)
        return largest > MIN_TILT_CHANGE and abs(sum(changes)) < TILT_BALANCE * largest


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceModel:
    """Block statistics of the reference's own intensity.

    mean, spread : float32 arrays of shape (rows, columns of blocks, 3)
    """

    mean: Float32Array
    spread: Float32Array

    @classmethod
    def of(cls, reference: NormalizedImage) -> ReferenceModel:
        """Statistics of the reference's intensity image: the frame divided by its own flat field."""
        return cls(*_blocks(reference.values))

    def detect(self, intensity: NormalizedImage) -> UntouchedRegion | None:
        """Untouched skin in an intensity image of the reference's size; None if too few blocks agree."""
        mean, spread = _blocks(intensity.values)
        ratio = mean / self.mean
        quiet: MaskArray = np.asarray((spread < NOISIER * self.spread + SPREAD_FLOOR).all(axis=-1))
        side = _side(intensity.values)
        agreeing = _agreeing(ratio, quiet, AGREEING + NOISE_SIGMAS / side * self.spread)
        if agreeing.mean() < MIN_FRACTION:
            return None
        return _region(ratio, agreeing)

    def assume_untouched(self, intensity: NormalizedImage) -> UntouchedRegion:
        """The same for a frame that is known to be untouched: every block counts."""
        ratio = _blocks(intensity.values)[0] / self.mean
        return _region(ratio, np.ones(ratio.shape[:2], np.bool_))


class LightDriftMonitor:
    """The last accepted levels of the lights."""

    def __init__(self) -> None:
        self._levels = (1.0, 1.0, 1.0)
        self._whole: tuple[float, float, float] | None = None
        self._is_measured = False
        self._pattern: float | None = None
        self._unseen_scans = 0

    @property
    def changes(self) -> tuple[float, float, float] | None:
        """Relative change of each light since calibration, R, G, B; None before the first measurement."""
        red, green, blue = self._levels
        return (red - 1.0, green - 1.0, blue - 1.0) if self._is_measured else None

    @property
    def pattern(self) -> float | None:
        """Rms change of the untouched skin's pattern in the last fully untouched frame; None before the first."""
        return self._pattern

    @property
    def unseen_scans(self) -> int:
        """Scans since the last accepted measurement."""
        return self._unseen_scans

    def update(self, region: UntouchedRegion | None) -> bool:
        """Use a measurement; returns whether it was accepted."""
        if region is None or region.is_tilt:
            return False
        before = self._whole or self._levels
        step = max(abs(new - old) for new, old in zip(region.levels, before, strict=True))
        if not region.is_whole and step > MAX_STEP:
            return False
        self._levels, self._is_measured, self._unseen_scans = region.levels, True, 0
        if region.is_whole:
            self._whole, self._pattern = region.levels, region.pattern
        return True

    def update_from_scan(self, region: UntouchedRegion | None) -> None:
        """Use what a scan's frame showed, and count the scan if that was nothing."""
        if not self.update(region):
            self._unseen_scans += 1


def gel_defects(untouched: LinearFrame) -> MaskArray:
    """Scratches, dust and stains in a frame of untouched skin: bool array of shape (H, W)."""
    margin = round(3.0 * SURROUNDINGS_PX)
    # Odd reflection continues a gradient of the light beyond the border, where plain reflection would bend it.
    padded = np.pad(untouched.rgb, ((margin, margin), (margin, margin), (0, 0)), mode="reflect", reflect_type="odd")
    spot = cv2.GaussianBlur(padded, (0, 0), NOISE_BLUR_PX)
    around = cv2.GaussianBlur(padded, (0, 0), SURROUNDINGS_PX)
    contrast: Float32Array = np.abs(spot / np.maximum(around, np.float32(1e-3)) - np.float32(1.0))
    inside = contrast[margin:-margin, margin:-margin].max(axis=-1)
    return np.asarray(inside > DEFECT_CONTRAST, np.bool_)


def _side(values: Float32Array) -> int:
    """Side of a block, px."""
    return max(int(values.shape[1]) // BLOCKS_ACROSS, 2)


def _blocks(values: Float32Array) -> tuple[Float32Array, Float32Array]:
    """Mean and standard deviation of each block: float32 arrays of shape (rows, columns of blocks, 3)."""
    side = _side(values)
    rows, columns = values.shape[0] // side, values.shape[1] // side
    cut = np.ascontiguousarray(values[: rows * side, : columns * side]) - np.float32(1.0)
    mean, square = (cv2.resize(part, (columns, rows), interpolation=cv2.INTER_AREA) for part in (cut, cut * cut))
    spread = np.sqrt(np.maximum(square - mean * mean, np.float32(0.0)))
    return np.asarray(mean + np.float32(1.0), np.float32), np.asarray(spread, np.float32)


def _agreeing(ratio: Float32Array, quiet: MaskArray, window: Float32Array) -> MaskArray:
    """Quiet blocks near the median, found by repeated outlier rejection."""
    kept = quiet
    for wider in (4.0, 2.0, 1.0, 1.0):
        if not kept.any():
            break
        level = np.median(ratio[kept], axis=0)
        allowed = wider * (window + AGREEING_PER_CHANGE * np.abs(level - 1.0).max())
        kept = quiet & np.asarray((np.abs(ratio / level - 1.0) < allowed).all(axis=-1))
    return kept


def _region(ratio: Float32Array, kept: MaskArray) -> UntouchedRegion:
    level = ratio[kept].mean(axis=0)
    pattern = float(np.sqrt(np.mean((ratio[kept] / level - 1.0) ** 2)))
    red, green, blue = (float(value) for value in level)
    return UntouchedRegion((red, green, blue), float(kept.mean()), pattern)
