"""By how much the lamps of a frame shine otherwise than they did in the calibration: one factor a channel.

A lamp that is a per cent weaker tilts all slopes by a hundredth, which a field of a thousand pixels adds up to ten
pixels of height. Untouched skin far from what was touched, whose slopes are zero, tells the factors to some 0.01 %.
What is no more than their uncertainty, or than the calibration's own presses differ by once
their own drift is out (`press_drift`), counts as no drift.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import cv2
import msgspec
import numpy as np

from device.imaging.flat_field import DARK_FLOOR, NormalizedImage
from device.inverse_map.model import InverseMap
from device.surface.fields import Float32Array, Float64Array, GradientField, HeightMap, MaskArray
from device.surface.poisson_dct import integrate_dct
from host_sync.frame_checks.light_levels import SlopeResponse, cell_logs, untouched_levels
from host_sync.gradients.cell_slopes import slopes_of_means
from host_sync.integration.zero_level import Datum, block_medians, find_datum, trimmed_mean
from host_sync.kernels.cell_rows import WHOLE_CELL

ACROSS: Final = 192
SAMPLES_ALONG: Final = 1024
"""Cells of the reduced field, and the columns of which they are the mean, about."""

MIN_CELLS: Final = 8
"""Cells along the shorter side of a field that tells anything."""

ROUNDS: Final = 3
SETTLED: Final = 0.002
"""Slopes of the next round are free of what the last one found, until that changes by no more than this."""

MIN_BLOCKS: Final = 6
MIN_PRESSES: Final = 4
ALIKE_BLOCKS: Final = 2.0
"""Blocks that err together."""

MIN_SIGMA: Final = 1e-4
"""Standard uncertainty of a log level, at least, where all of the field is untouched; where less of it is, skin still
sinks towards rest, and the uncertainty is larger by one over that share."""

MIN_SHARE: Final = 0.05
"""Share of the field that is untouched, below which it tells nothing: there may be none between objects."""

TILT_SHARE: Final = 0.15
"""Of a drift, that two slopes of every place must leave; three lamps that drift each as they like leave less in one of
seven cases, which are then read as sloping skin."""

MAX_DRIFT: Final = 0.15
"""Share by which a lamp may have changed for its drift to be taken out."""

DOUBTED: Final = 9.0
"""Mean square of a drift, in standard uncertainties, up to which it counts as no drift."""


@dataclass(frozen=True, slots=True, eq=False)
class UntouchedLevel:
    """Light of untouched skin over the reference's.

    logs : logarithms by channel, float64 array of shape (3,)
    covariance : of them, shape (3, 3)
    blocks : logarithms of each of N blocks of the field, shape (N, 3)
    skin : bool array of shape (h, w), cells of the field that show it
    """

    logs: Float64Array
    covariance: Float64Array
    blocks: Float64Array
    skin: MaskArray


class PressLevels(msgspec.Struct, frozen=True):
    """Logarithms of each channel's light in the calibration's presses over the reference's.

    mean : three
    sigma : by which one more frame differs, standard deviation of either channel. One for all three: a dozen presses
        tell no covariance well enough
    stray_sigma : stray light that presses seem to show, root mean square, share of full scale; None where they tell
        none
    """

    mean: tuple[float, ...]
    sigma: float
    stray_sigma: float | None = None

    @classmethod
    def of(cls, presses: Iterable[NormalizedImage], inverse_map: InverseMap) -> PressLevels | None:
        """What presses show; None where fewer than `MIN_PRESSES` show untouched skin."""
        told = [found.logs for press in presses if (found := untouched_level(press, inverse_map)) is not None]
        if len(told) < MIN_PRESSES:
            return None
        levels = np.array(told)
        variance = float(levels.var(axis=0, ddof=1).mean()) * (1.0 + 1.0 / len(levels))
        return cls(tuple(float(one) for one in levels.mean(axis=0)), float(np.sqrt(variance)))


def take_drift_out(
    image: NormalizedImage, inverse_map: InverseMap, presses: PressLevels | None, response: SlopeResponse | None
) -> float:
    """Write the intensity under lamps that shine as in the calibration over an image's own.

    Returns the largest change of a lamp, as a share; 0 where nothing was written. A lamp that changed by more than
    `MAX_DRIFT` is left as it is, for others to refuse.

    presses, response : of the calibration; None where its balls do not tell them
    """
    found = None if presses is None or response is None else untouched_level(image, inverse_map)
    if presses is None or response is None or found is None:
        return 0.0
    drift = found.logs - np.array(presses.mean)
    drift *= believed_share(drift, found.covariance + presses.sigma**2 * np.eye(3))
    largest = float(np.expm1(np.abs(drift).max()))
    if not 0.0 < largest <= MAX_DRIFT or is_tilt(found.blocks - np.array(presses.mean), response, found.skin):
        return 0.0
    np.multiply(image.values, np.exp(-drift).astype(np.float32), out=image.values)
    return largest


def is_tilt(levels: Float64Array, response: SlopeResponse, skin: MaskArray) -> bool:
    """Whether sloping skin explains the levels as well: any two slopes are allowed at each place.

    levels : log levels of shape (N, 3) of the blocks of the field that show this skin
    """
    answers = response.at(skin.shape).reshape(*skin.shape, 6).astype(np.float32)
    along = by_block(answers, skin).reshape(-1, 2, 3)
    beside = np.cross(along[:, 0], along[:, 1])
    left = (beside * levels).sum(axis=1) / np.maximum(np.linalg.norm(beside, axis=1), 1e-12)
    return bool(np.sqrt((left**2).mean()) < TILT_SHARE * np.sqrt((levels**2).sum(axis=1).mean()))


def untouched_level(image: NormalizedImage, inverse_map: InverseMap) -> UntouchedLevel | None:
    """The level of a frame's untouched skin; None where too little of it is untouched."""
    cells = FieldCells.of(image)
    if cells is None:
        return None
    logs = np.log(np.maximum(cells.values, np.float32(DARK_FLOOR))).astype(np.float32)
    sights = untouched_levels(cell_logs(image))
    level = sights[0].levels if sights else np.zeros(3)
    for _ in range(ROUNDS):
        datum = cells.datum(cells.values * np.exp(-level).astype(np.float32), inverse_map)
        blocks = by_block(logs, datum.skin)
        if len(blocks) < MIN_BLOCKS or datum.share < MIN_SHARE:
            return None
        before, level = level, trimmed_mean(blocks)
        if np.abs(level - before).max() < SETTLED:
            break
    sinking = (MIN_SIGMA / datum.share) ** 2 * np.eye(3)
    covariance = np.cov(blocks.T) * (ALIKE_BLOCKS / len(blocks)) + sinking
    return UntouchedLevel(level, covariance, blocks, datum.skin)


@dataclass(frozen=True, slots=True, eq=False)
class FieldCells:
    """A frame in cells.

    values : mean intensity, float32 array of shape (h, w, 3)
    known : bool array of shape (h, w), True for faithful cells
    """

    values: Float32Array
    known: MaskArray

    @classmethod
    def of(cls, image: NormalizedImage) -> FieldCells | None:
        """The cells of a frame; None where they are too few to tell anything."""
        values = in_cells(np.nan_to_num(image.values[samples_of(image.shape)]), image.shape)
        known = in_cells(image.faithful_at(samples_of(image.shape)).astype(np.float32), image.shape) > WHOLE_CELL
        return cls(values, known) if min(known.shape) >= MIN_CELLS else None

    def datum(self, values: Float32Array, inverse_map: InverseMap) -> Datum:
        """Untouched skin where the cells have these values (h, w, 3)."""
        p, q = (np.where(self.known, slope, np.float32(0.0)) for slope in slopes_of_means(values, inverse_map))
        gradients = GradientField(p, q, self.known, self.known.astype(np.float32))
        return find_datum(HeightMap(integrate_dct(p, q, 1.0), 1.0), gradients)


def in_cells(samples: Float32Array, shape: tuple[int, int]) -> Float32Array:
    """Means over cells of every so many-th pixel of an array (H, W, ...), as `samples_of` takes them."""
    rows, columns = shape
    across = min(ACROSS, columns)
    size = across, max(round(rows * across / columns), 1)
    return np.asarray(cv2.resize(np.ascontiguousarray(samples), size, interpolation=cv2.INTER_AREA), np.float32)


def samples_of(shape: tuple[int, int]) -> tuple[slice, slice]:
    """Index of the pixels of a frame (H, W) that its cells are the means of."""
    stride = max(1, shape[1] // SAMPLES_ALONG)
    some = slice(stride // 2, None, stride)
    return some, some


def by_block(cells: Float32Array, skin: MaskArray) -> Float64Array:
    """Median (N, K) of cells (h, w, K) over each block of the field that shows enough of this skin."""
    layers = range(cells.shape[-1])
    return np.stack([block_medians(np.ascontiguousarray(cells[..., layer]), skin) for layer in layers], axis=-1)


def believed_share(level: Float64Array, covariance: Float64Array) -> float:
    """Which share of log levels (3,) is a drift, and not their own uncertainty."""
    square = float(level @ np.linalg.solve(covariance, level)) / 3.0
    return 1.0 - min(DOUBTED / max(square, DOUBTED), 1.0) ** 2
