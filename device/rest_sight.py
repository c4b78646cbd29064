"""What a frame shows of untouched skin: how bright each light is now against the reference, where that can be told.

The field is cut into blocks. A block of untouched skin differs from the reference by one factor a channel and by the
sensor's noise; shading spreads wider. Where enough blocks agree on the three factors, those are the lights. A frame in
which they do not is not evidence: pressed skin moves intensity as a weak light does, and no guess is better than none.

A flat thing that covers the whole field looks much like untouched skin. Two traits give it away: near lights reach
skin that is pushed towards them unevenly, so that blocks disagree; and a tilt brightens one side as much as it darkens
the other, so that the three changes add up to nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from device.photometry import IntensityImage
from device.surface import Float32Array, MaskArray

BLOCKS_ACROSS: Final = 24
AGREEING: Final = 0.006
NOISE_SIGMAS: Final = 3.0
AGREEING_PER_CHANGE: Final = 0.12
"""Blocks of untouched skin agree on the level of a light to this share and so many standard errors, and by so much of
the change itself: what filters pass of other lights differs over the field."""

FEWEST_SHARE: Final = 0.33
"""Share of the blocks that must agree."""

WHOLE_SHARE: Final = 0.9
"""Share of agreeing blocks from which nothing touches the skin."""

NOISIER: Final = 1.5
SPREAD_FLOOR: Final = 0.003
"""A block whose spread exceeds this many times its spread at rest, and this share, is shaded."""

TILT_BALANCE: Final = 0.35
TILT_NOTICED: Final = 0.008
"""Changes beyond the latter whose sum stays under this share of the largest are a tilt, not lights."""


@dataclass(frozen=True, slots=True)
class RestSight:
    """What was seen of untouched skin.

    levels : of the R, G and B channel over the reference's
    share : of the field's blocks that agree on them
    pattern : root mean square deviation of those blocks from the reference's pattern, the levels taken out
    """

    levels: tuple[float, float, float]
    share: float
    pattern: float

    @property
    def is_whole(self) -> bool:
        """Whether the whole field is at rest."""
        return self.share >= WHOLE_SHARE

    @property
    def is_tilt(self) -> bool:
        """Whether the changes look like a tilt of the whole field rather than like lights."""
        changes = [level - 1.0 for level in self.levels]
        largest = max(abs(change) for change in changes)
        return largest > TILT_NOTICED and abs(sum(changes)) < TILT_BALANCE * largest


@dataclass(frozen=True, slots=True, eq=False)
class RestModel:
    """The reference in blocks, as its own intensity shows it.

    mean, spread : float32 arrays of shape (rows, columns of blocks, 3)
    """

    mean: Float32Array
    spread: Float32Array

    @classmethod
    def of(cls, reference: IntensityImage) -> RestModel:
        """The model of the reference's own intensity image: the frame divided by its blurred self."""
        return cls(*_blocks(reference.values))

    def see(self, intensity: IntensityImage) -> RestSight | None:
        """What an intensity image of the same size shows of untouched skin; None when that cannot be told."""
        mean, spread = _blocks(intensity.values)
        ratio = mean / self.mean
        quiet: MaskArray = np.asarray((spread < NOISIER * self.spread + SPREAD_FLOOR).all(axis=-1))
        side = _side(intensity.values)
        agreeing = _agreeing(ratio, quiet, AGREEING + NOISE_SIGMAS / side * self.spread)
        if agreeing.mean() < FEWEST_SHARE:
            return None
        return _sight(ratio, agreeing)

    def trust(self, intensity: IntensityImage) -> RestSight:
        """The same for a frame that somebody vouches for as untouched: every block counts."""
        ratio = _blocks(intensity.values)[0] / self.mean
        return _sight(ratio, np.ones(ratio.shape[:2], np.bool_))


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
    """Blocks near the median of those that are quiet, found by leaving outliers out again and again."""
    kept = quiet
    for wider in (4.0, 2.0, 1.0, 1.0):
        if not kept.any():
            break
        level = np.median(ratio[kept], axis=0)
        allowed = wider * (window + AGREEING_PER_CHANGE * np.abs(level - 1.0).max())
        kept = quiet & np.asarray((np.abs(ratio / level - 1.0) < allowed).all(axis=-1))
    return kept


def _sight(ratio: Float32Array, kept: MaskArray) -> RestSight:
    level = ratio[kept].mean(axis=0)
    pattern = float(np.sqrt(np.mean((ratio[kept] / level - 1.0) ** 2)))
    red, green, blue = (float(value) for value in level)
    return RestSight((red, green, blue), float(kept.mean()), pattern)
