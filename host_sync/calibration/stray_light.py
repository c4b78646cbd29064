"""Light of the surroundings in a scan, by channel, told by untouched skin: it counts most where the lamps give little.

Stray light o adds to that of the lamps, drift g multiplies it: untouched skin whose reference light is f shows

    I(x, y) = g + o / f(x, y)

over the reference. One per cent of full scale reads as slopes wherever f is not even, and adds up over the field to a
hundred micrometres where lamps are near. A frame taken under no light tells it better, and is asked for first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import msgspec
import numpy as np

from device.imaging.flat_field import DARK_FLOOR, NormalizedImage
from device.inverse_map.model import InverseMap
from device.surface.fields import Float32Array, Float64Array, MaskArray
from host_sync.calibration.lamp_drift import (
    ALIKE_BLOCKS,
    MAX_DRIFT,
    MIN_BLOCKS,
    MIN_PRESSES,
    MIN_SHARE,
    FieldCells,
    PressLevels,
    believed_share,
    by_block,
    in_cells,
    is_tilt,
    samples_of,
)
from host_sync.frame_checks.light_levels import SlopeResponse

MAX_STRAY: Final = 0.05
"""Share of full scale up to which stray light is taken out."""

ROUNDS: Final = 8
SETTLED: Final = 1e-4
"""Untouched skin is sought again without the stray light that was found, until that changes by no more."""

MIN_STRAY_SIGMA: Final = 1e-4
"""Standard uncertainty of stray light, at least, where all of the field is untouched; larger by one over its share:
skin that has not sunk to rest yet is up to 0.0013 of full scale darker beside an object on a fifth of the field.
"""

FIT_ROUNDS: Final = 6
CAUCHY: Final = 2.0
"""Deviations of a block, in standard deviations, at which its weight has fallen to a half."""

ALIKE_SHARE: Final = 0.4
"""Share of the blocks that the line of another search comes closest to: skin that is untouched shows one line, skin on
objects shows its slopes and its elevation, too, and a line through all blocks may lead astray.
"""

CLEAR_SHARE: Final = 0.15
"""Share of the field that one search finds untouched, from which on there is no other."""

UNKNOWN: Final = 1.0
"""Standard uncertainty, share of full scale, where untouched skin is lit evenly and tells no stray light."""

DARKEST_SKIN: Final = 0.5
"""Intensity of untouched skin, at least."""


@dataclass(frozen=True, slots=True, eq=False)
class StrayLight:
    """Light that no lamp gives.

    light : share of full scale by channel, float64 array of shape (3,)
    sigma : its standard uncertainty, shape (3,)
    level : logarithm of the lamps' light over the reference's, shape (3,)
    blocks : the same with stray light, of each of N blocks of the field, shape (N, 3)
    skin : bool array of shape (h, w), cells of the field that show untouched skin
    """

    light: Float64Array
    sigma: Float64Array
    level: Float64Array
    blocks: Float64Array
    skin: MaskArray

    def believed(self, known_to: float) -> Float64Array:
        """The part of the light that its uncertainty, and that of `known_to` in every frame, do not explain."""
        return self.light * believed_share(self.light, np.diag(self.sigma**2 + known_to**2))


def find_stray_light(
    image: NormalizedImage, flat_field: Float32Array, inverse_map: InverseMap, *, thorough: bool = True
) -> StrayLight | None:
    """The stray light of a frame; None where too little untouched skin is seen.

    thorough : look for untouched skin again without what was found, where it is more than its uncertainty
    """
    cells = FieldCells.of(image)
    if cells is None:
        return None
    brightness = by_block(cells.values, cells.known)
    if len(brightness) < MIN_BLOCKS:
        return None
    light_at_rest = np.maximum(flat_field[samples_of(image.shape)], np.float32(DARK_FLOOR))
    each = in_cells(np.reciprocal(light_at_rest), image.shape)
    blocks = by_block(each, cells.known), brightness
    found = _search(cells, each, inverse_map, *_lines(*blocks)[:2], ROUNDS if thorough else 1)
    if not thorough or (found is not None and found.skin.mean() >= CLEAR_SHARE):
        return found
    other = _search(cells, each, inverse_map, *_lines_of_most_alike(*blocks)[:2], ROUNDS)
    return max(filter(None, (found, other)), key=lambda one: float(one.skin.mean()), default=None)


def _search(
    cells: FieldCells,
    each: Float32Array,
    inverse_map: InverseMap,
    level: Float64Array,
    light: Float64Array,
    rounds: int,
) -> StrayLight | None:
    """The stray light near that of a start; None where it leads to too little untouched skin.

    each : one over the reference's light in cells, shape (h, w, 3)
    level, light : of the start, as of `StrayLight`
    """
    found = None
    for _ in range(rounds):
        as_lit = (cells.values - light.astype(np.float32) * each) * np.exp(-level).astype(np.float32)
        datum = cells.datum(as_lit, inverse_map)
        brightness = by_block(cells.values, datum.skin)
        if len(brightness) < MIN_BLOCKS or datum.share < MIN_SHARE:
            break
        before = light
        level, light, sigma = _lines(by_block(each, datum.skin), brightness)
        blocks = np.log(np.maximum(brightness, DARKEST_SKIN))
        found = StrayLight(light, np.hypot(sigma, MIN_STRAY_SIGMA / datum.share), level, blocks, datum.skin)
        if not found.believed(0.0).any() or np.abs(light - before).max() < SETTLED:
            break
    return found


def take_stray_light_out(
    image: NormalizedImage,
    flat_field: Float32Array,
    inverse_map: InverseMap,
    presses: PressLevels | None,
    response: SlopeResponse | None,
) -> float:
    """Write the intensity without stray light over an image's own.

    Returns the largest share of full scale that was taken out; 0 where nothing was written: no more is found than its
    uncertainty or than presses show, a channel is darker, a tilted plate shows as much, it is more than `MAX_STRAY`, or
    the lamps have changed by more than `MAX_DRIFT`.

    presses, response : of the calibration; None where its balls do not tell them
    """
    if presses is None or presses.stray_sigma is None or response is None:
        return 0.0
    found = find_stray_light(image, flat_field, inverse_map)
    if found is None:
        return 0.0
    light = found.believed(presses.stray_sigma)
    if not 0.0 < light.min() <= light.max() <= MAX_STRAY or np.expm1(np.abs(found.level).max()) > MAX_DRIFT:
        return 0.0
    if is_tilt(found.blocks - np.array(presses.mean), response, found.skin):
        return 0.0
    np.subtract(
        image.values, light.astype(np.float32) / np.maximum(flat_field, np.float32(DARK_FLOOR)), out=image.values
    )
    return float(np.abs(light).max())


def with_stray_light(
    levels: PressLevels | None, presses: Sequence[NormalizedImage], flat_field: Float32Array, inverse_map: InverseMap
) -> PressLevels | None:
    """The levels with the stray light that the presses seem to show, which have none."""
    if levels is None:
        return None
    found = [find_stray_light(press, flat_field, inverse_map, thorough=False) for press in presses]
    seen = [one.light for one in found if one is not None]
    if len(seen) < MIN_PRESSES:
        return levels
    return msgspec.structs.replace(levels, stray_sigma=float(np.sqrt((np.array(seen) ** 2).mean())))


def _lines_of_most_alike(
    each: Float64Array, brightness: Float64Array
) -> tuple[Float64Array, Float64Array, Float64Array]:
    """As `_lines`, of the share of the blocks that agree best with each other, in all channels: it begins at the line
    through two blocks that this share comes closest to.
    """
    one, other = np.triu_indices(len(each), 1)
    apart = each[other] - each[one]
    light = np.divide(brightness[other] - brightness[one], apart, out=np.zeros_like(apart), where=apart != 0.0)
    off = np.abs(brightness - brightness[one][:, None] - light[:, None] * (each - each[one][:, None])).max(axis=-1)
    count = max(int(ALIKE_SHARE * len(each)), 2)
    alike = off[np.partition(off, count - 1, axis=1)[:, count - 1].argmin()].argsort()[:count]
    for _ in range(FIT_ROUNDS):
        found = _lines(each[alike], brightness[alike])
        left = np.abs(brightness - np.exp(found[0]) - found[1] * each).max(axis=-1)
        alike = left.argsort()[:count]
    return found


def _lines(each: Float64Array, brightness: Float64Array) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Log level, stray light and its sigma, by channel, of N > 0 blocks' reciprocal light and brightness (N, 3)."""
    lines = [_line(x, y) for x, y in zip(each.T, brightness.T, strict=True)]
    at_zero, light, sigma = (np.array(part) for part in zip(*lines, strict=True))
    return np.log(np.maximum(at_zero, DARKEST_SKIN)), light, sigma


def _line(x: Float64Array, y: Float64Array) -> tuple[float, float, float]:
    """Value at zero and slope of a line through N points, which outliers do not bend, and the slope's sigma."""
    middle = float(x.mean())
    along = float(((x - middle) ** 2).sum())
    if along <= 0.0:
        return float(np.median(y)), 0.0, UNKNOWN
    design = np.stack([np.ones_like(x), x - middle], axis=-1)
    weight = np.ones_like(x)
    for _ in range(FIT_ROUNDS):
        root = np.sqrt(weight)
        found = np.linalg.lstsq(design * root[:, None], y * root, rcond=None)[0]
        left = y - design @ found
        scale = 1.4826 * float(np.median(np.abs(left))) + 1e-7
        weight = 1.0 / (1.0 + (left / (CAUCHY * scale)) ** 2)
    sigma = float(np.sqrt(ALIKE_BLOCKS * float(left.var()) / along))
    return float(found[0] - found[1] * middle), float(found[1]), min(sigma, UNKNOWN)
