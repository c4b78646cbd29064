"""The zero of a height map: all untouched skin that lies far from what was touched, and how far it agrees with itself.

Flat skin that reaches the border is untouched or lies on an object that reaches beyond the border. Objects press the
skin towards the camera, so that of flat parts the lowest ones are untouched. Around an object skin sinks towards rest
over a long way, so gently that it passes for flat: only what lies far from everything else counts. Its heights differ
from place to place by what errors of slopes add up to: the zero's uncertainty is a share of that spread. Where no skin
is untouched, as where an object's fine texture fills the field, or clearly lies under other skin, a height map has no
zero: its heights are relative to each other.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from device.surface import Float32Array, Float64Array, GradientField, HeightMap, MaskArray
from host_sync.integration.datum import SurfaceCells, height_of_rest_um, is_relief, skin_at_rest
from host_sync.kernels.jit import njit

NO_ZERO: Final = "no zero: heights are relative, because no untouched skin was found"
"""The warning where nothing was taken for zero."""

FAR_WEIGHT: Final = 0.2
"""Of the largest distance from touched skin; skin farther off is far."""

MIN_FRACTION: Final = 0.02
"""Share of the field that flat skin must make up to be the lowest, and far skin to do without the rest of it."""

CORNERS: Final = 4
"""Parts that skin at rest by its light may consist of to make up that share: a large object leaves corners free."""

ALIKE_FRACTION: Final = 0.1
"""Flat parts this share of the map's height above the lowest are untouched too: long waves are known least."""

HEIGHT_PERCENT: Final = (1.0, 99.0)
"""Percentiles between which a map's heights lie."""

MAX_UNDER: Final = 0.01
"""Share of the field that may lie clearly under untouched skin: objects press skin towards the camera only."""

UNDER_FRACTION: Final = 0.15
UNDER_FIELD: Final = 0.0016
"""How far under counts as clear: shares of the map's height and of the field's width.

Incompressible gel bulges away from the camera beside an object, by a few per cent of its height; errors of slopes add
up to a thousandth of the field, if they are large.
"""

ZERO_SIGMA_BY_SPREAD: Final = 0.7
"""Standard uncertainty of the mean of blocks' heights, as a share of their spread: slope errors add up over the field,
so that blocks do not err independently.

On eleven rendered devices the mean was off by 0.1 to 0.3 of the spread. Objects, whose heights feel the same errors of
slopes, were off by 0.7 to 1.7 of it.
"""

SINKING_SIGMA: Final = 0.5
"""Standard uncertainty of how much skin sinks yet, as a share: elastomers are thicker than a membrane on springs."""

TRIMMED: Final = 0.2
"""Share of the blocks that is left out at either end of their heights when the zero is taken."""

WIDEST_CELLS: Final = 256
"""Cells along the reduced field's columns, at most: distances need no more."""

BLOCKS: Final = 8
"""Blocks along the field's columns whose heights are compared."""

MIN_CELLS: Final = 8
"""Far cells of a block that is compared."""


@dataclass(frozen=True, slots=True, eq=False)
class Datum:
    """Skin that defines a height map's zero.

    skin : bool array of shape (H, W), True where heights are zero but for their errors; every valid pixel where no
        skin is untouched
    zero_um : trimmed mean of the median heights of its blocks, less `sinking_um`, µm
    spread_um : root mean square of its blocks' median heights, µm; of all heights where no skin is untouched
    share : of the field that it makes up; 0 where no skin is untouched
    blocks : how many parts of the field it was compared in
    sinking_um : by how much the skin still stands above rest, µm; the zero lies so much lower
    """

    skin: MaskArray
    zero_um: float
    spread_um: float
    share: float
    blocks: int = 1
    sinking_um: float = 0.0

    @property
    def zero_sigma_um(self) -> float:
        """Standard uncertainty of the zero, µm: of the skin it is taken from, and of how much that sinks yet."""
        return self.zero_sigma_beside_um(0.0)

    def zero_sigma_beside_um(self, known_um: float) -> float:
        """Return the standard uncertainty of the zero in addition to known errors of slopes, µm.

        known_um : root mean square by which those errors let blocks' heights differ
        """
        share = 1.0 if self.is_relative else ZERO_SIGMA_BY_SPREAD
        left_um = share * np.sqrt(max(self.spread_um**2 - known_um**2, 0.0))
        return float(np.hypot(left_um, SINKING_SIGMA * self.sinking_um))

    @property
    def is_relative(self) -> bool:
        """True if no skin is untouched, so that heights have no zero."""
        return self.share <= 0.0

    def level(self, height: HeightMap) -> HeightMap:
        """Return the height map above this zero."""
        return HeightMap(height.z_um - np.float32(self.zero_um), height.pitch_um)

    def of(self, height: HeightMap) -> Datum:
        """Return the datum of another height map of the same skin."""
        return _no_datum_on(height, self.skin) if self.is_relative else _datum_on(height, self.skin)

    def at_rest(self, height: HeightMap, gradients: GradientField) -> Datum:
        """Return the datum with its zero where skin of a height map with these slopes will have sunk to rest."""
        if self.is_relative:
            return self
        left_um = height_left_um(height, gradients, self.skin, self.zero_um)
        return replace(self, zero_um=self.zero_um - left_um, sinking_um=left_um)


def find_datum(
    height: HeightMap, gradients: GradientField, *, are_its_own: bool = False, at_rest: MaskArray | None = None
) -> Datum:
    """Return the datum of a height map that has these slopes.

    at_rest : bool array of shape (H, W), skin whose light is that of skin at rest; None to judge by slopes alone
    are_its_own : whether slopes were taken from the height map: then they cannot show what belongs to no surface
    """
    if at_rest is not None:
        resting = at_rest & gradients.valid
        low = _far_and_low(resting, gradients.valid, height.z_um, MIN_FRACTION / CORNERS)
        return no_datum(height, gradients) if low is None else _datum_on(height, low)
    at_rest = skin_at_rest(gradients)
    far = None if at_rest is None else _far_and_low(at_rest, gradients.valid, height.z_um)
    if far is None or (
        not are_its_own and (_is_over_others(height, gradients.valid, far) or is_relief(height, gradients, far))
    ):
        return no_datum(height, gradients)
    return _datum_on(height, far)


def _datum_on(height: HeightMap, skin: MaskArray) -> Datum:
    """Return the datum of a height map whose skin is untouched here."""
    blocks_um = block_medians(height.z_um, skin)
    zero_um = float(trimmed_mean(blocks_um)) if blocks_um.size else height_of_rest_um(height, skin)
    spread_um = float(np.sqrt(((blocks_um - zero_um) ** 2).mean())) if blocks_um.size else 0.0
    return Datum(skin, zero_um, spread_um, float(np.count_nonzero(skin)) / skin.size, blocks_um.size)


def no_datum(height: HeightMap, gradients: GradientField) -> Datum:
    """Return what the heights of a map are relative to where no skin is untouched."""
    return _no_datum_on(height, gradients.valid)


def _no_datum_on(height: HeightMap, valid: MaskArray) -> Datum:
    known = height.z_um[valid]
    spread_um = float(np.nanstd(known)) if known.size else 0.0
    return Datum(valid, height_of_rest_um(height, valid), spread_um, 0.0)


def _is_over_others(height: HeightMap, valid: MaskArray, skin: MaskArray) -> bool:
    """Return True if more than `MAX_UNDER` of the valid field lies clearly under this skin, so that it is touched."""
    step = max(1, height.z_um.shape[1] // WIDEST_CELLS)
    known_um = height.z_um[::step, ::step]
    known_um = known_um[valid[::step, ::step] & np.isfinite(known_um)]
    if not known_um.size:
        return False
    low_um, high_um = np.percentile(known_um, HEIGHT_PERCENT)
    field_um = height.z_um.shape[1] * height.pitch_um
    under_um = max(UNDER_FRACTION * float(high_um - low_um), UNDER_FIELD * field_um)
    return bool((known_um < height_of_rest_um(height, skin) - under_um).mean() > MAX_UNDER)


def _far_and_low(
    flat: MaskArray, valid: MaskArray, z_um: Float32Array, part_share: float = MIN_FRACTION
) -> MaskArray | None:
    """Return the lowest large parts of flat skin, far from all other valid skin: bool (H, W), None without such.

    part_share : as of `_lowest_parts`
    """
    rows, columns = flat.shape
    here = _cells(flat.shape)
    resting = _lowest_parts(flat[here], z_um[here], part_share)
    if not resting.any():
        return None
    other = valid[here] & ~resting
    if other.any():
        distance = distance_px(other)
        away = resting & (distance >= FAR_WEIGHT * float(distance[resting].max(initial=0.0)))
        resting = away if away.mean() >= MIN_FRACTION else resting
    full = cv2.resize(resting.astype(np.uint8), (columns, rows), interpolation=cv2.INTER_NEAREST).view(np.bool_)
    return np.asarray(full & flat)


def _cells(shape: tuple[int, ...]) -> tuple[NDArray[np.intp], ...]:
    """Return the index of the pixels at the middles of the cells of the reduced field."""
    rows, columns = shape
    across = min(columns, WIDEST_CELLS)
    sizes = (max(1, round(rows * across / columns)), rows), (across, columns)
    return np.ix_(*(((np.arange(count) + 0.5) * (full / count)).astype(np.intp) for count, full in sizes))


def _lowest_parts(flat: MaskArray, z_um: Float32Array, part_share: float) -> MaskArray:
    """Return the connected parts of a mask that stand about as high as the lowest.

    Together they make up `MIN_FRACTION` of the field, else none is returned. What is rough all over has small patches
    that are flat on average; they are none of these.

    part_share : of the field that each must make up
    """
    _, labels = cv2.connectedComponents(flat.astype(np.uint8), connectivity=4)
    known = flat & np.isfinite(z_um)
    share = np.bincount(labels[known], minlength=labels.max() + 1) / flat.size
    large = [number for number in range(1, share.size) if share[number] >= part_share]
    if not large:
        return np.zeros_like(flat)
    level = {number: float(np.median(z_um[known & (labels == number)])) for number in large}
    low, high = np.percentile(z_um[np.isfinite(z_um)], HEIGHT_PERCENT)
    for number in sorted(large, key=level.__getitem__):
        alike = [other for other in large if 0.0 <= level[other] - level[number] <= ALIKE_FRACTION * float(high - low)]
        if share[alike].sum() >= MIN_FRACTION:
            return np.isin(labels, alike)
    return np.zeros_like(flat)


def block_medians(z_um: Float32Array, skin: MaskArray) -> Float64Array:
    """Return the median of a map (H, W) over each block that shows enough of this skin, shape (blocks,)."""
    step = max(1, skin.shape[1] // WIDEST_CELLS)
    z, here = np.ascontiguousarray(z_um[::step, ::step]), skin[::step, ::step]
    side = max(1, z.shape[1] // BLOCKS)
    medians = np.empty((-(-z.shape[0] // side), -(-z.shape[1] // side)))
    _write_medians(z, np.ascontiguousarray(here), side, medians)
    return medians[np.isfinite(medians)]


@njit(cache=True, nogil=True)
def _write_medians(z: Any, here: Any, side: int, medians: Any) -> None:
    """Write the median of finite heights of skin over each block of `side` x `side` cells; NaN of fewer than enough."""
    own = np.empty(side * side, z.dtype)
    for i in range(medians.shape[0]):
        for j in range(medians.shape[1]):
            count = 0
            for r in range(i * side, min((i + 1) * side, z.shape[0])):
                for c in range(j * side, min((j + 1) * side, z.shape[1])):
                    if here[r, c] and np.isfinite(z[r, c]):
                        own[count] = z[r, c]
                        count += 1
            medians[i, j] = np.median(own[:count]) if count >= MIN_CELLS else np.nan


def trimmed_mean(values: Float64Array) -> Float64Array:
    """Return the mean of N > 0 values, shape (N, ...), along the first axis, without their extremes.

    The fraction `TRIMMED` of them is left out at either end.
    """
    # Not scipy.stats: loading it takes as long as reconstructing a small frame.
    cut, count = int(TRIMMED * len(values)), len(values)
    inner = np.partition(values, (cut, count - cut - 1), axis=0)[cut : count - cut]
    return np.asarray(inner.mean(axis=0))


# Distances to the nearest pixel of a mask, with the same bits wherever they are computed.
#
# With one thread, and on small fields, OpenCV leaves precise distances to Intel's library. Its rounding differs from
# that of OpenCV's own code, and from call to call with where the array lies in memory.


def distance_px(to: MaskArray) -> Float32Array:
    """Return the distance of each pixel's middle from that of the nearest True one, pixels: float32 array (H, W).

    to : bool array of shape (H, W), True somewhere
    """
    with _own_code():
        found = cv2.distanceTransform((~to).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return np.asarray(found, np.float32)


@contextmanager
def _own_code() -> Iterator[None]:
    """Enter a context in which this thread's calls of OpenCV use no code of Intel's library."""
    before = cv2.ipp.useIPP()
    cv2.ipp.setUseIPP(False)
    try:
        yield
    finally:
        cv2.ipp.setUseIPP(before)


# Height of skin that was taken for zero: around an object it sinks towards rest for a long way.
#
# Free skin under tension that its elastomer pulls back is bent in proportion to its height: z = L² · div(slope), with
# one length L for the whole field (a membrane on springs). Where an object reaches far, all skin of a frame is still
# above rest. A line through its heights and bends gives L², and the height at which skin is not bent: the true zero.
# The bend is taken as the noisy one of both, so that noise moves no zero.

ACROSS: Final = 160
"""Cells along the reduced field's columns."""

SMOOTHING: Final = 2.0
"""Standard deviation, in cells, of the Gaussian that takes noise out of slopes before they are differentiated."""

LOW_FRACTION: Final = 0.25
"""Skin is free, as far as it hangs together with skin at rest, up to this share of the map's height."""

MIN_SINKING_CELLS: Final = 200
MIN_CORRELATION: Final = 0.8
"""Correlation of heights and bends below which bends are not used."""

ROUNDS: Final = 5
OUTLIER: Final = 2.5
"""Cells off by so many standard deviations are left out of the next round's line."""

MAX_LEFT: Final = 0.05
"""Of the map's height, at most, that skin at rest is taken to stand above zero."""


def height_left_um(height: HeightMap, gradients: GradientField, resting: MaskArray, zero_um: float) -> float:
    """Return the height of the zero above skin that is at rest, µm; 0 where free skin does not show it.

    gradients : its slopes, arrays of shape (H, W)
    resting : bool array of shape (H, W), skin from which the zero was taken
    zero_um : that zero
    """
    rows, columns = gradients.p.shape
    cell = max(1, round(columns / ACROSS))
    if min(rows, columns) < 2 * cell:
        return 0.0
    cells = SurfaceCells.of(height, gradients, zero_um, resting, cell)
    # Cells that the field's border cuts are left out.
    whole, pixels = (slice(rows // cell), slice(columns // cell)), cell * cell
    z, across, down = (_smooth(part[whole] * np.float32(1.0 / pixels)) for part in (cells.z_px, cells.p, cells.q))
    bend = np.gradient(across, cell, axis=1) + np.gradient(down, cell, axis=0)
    top_px = float(np.percentile(z, 99.0))
    low = (z < LOW_FRACTION * top_px) & (cells.count[whole] == pixels)
    free = _joined_to(low, cells.skin[whole] > 0.5 * pixels)
    if int(free.sum()) < MIN_SINKING_CELLS:
        return 0.0
    left_px = _unbent_at(z[free].astype(np.float64), bend[free].astype(np.float64))
    return float(np.clip(-left_px, 0.0, MAX_LEFT * max(top_px, 0.0)) * height.pitch_um)


def _unbent_at(z: Float64Array, bend: Float64Array) -> float:
    """Return the height at which skin is not bent, of heights and bends of shape (N,); 0 where they do not show it."""
    kept = np.ones(len(z), np.bool_)
    slope, start = 0.0, 0.0
    for _ in range(ROUNDS):
        slope, start = _line(z[kept], bend[kept])
        off = np.abs(bend - slope * z - start)
        kept = off < OUTLIER * max(float(np.sqrt((off[kept] ** 2).mean())), 1e-12)
    if slope <= 0.0 or float(np.corrcoef(z[kept], bend[kept])[0, 1]) < MIN_CORRELATION:
        return 0.0
    return float(-start / slope)


def _line(z: Float64Array, bend: Float64Array) -> tuple[float, float]:
    """Return the slope and value at zero of the line of least squares."""
    mean, bent = float(z.mean()), float(bend.mean())
    off = z - mean
    slope = float(off @ (bend - bent)) / max(float(off @ off), 1e-300)
    return slope, bent - slope * mean


def _joined_to(low: MaskArray, resting: MaskArray) -> MaskArray:
    """Return the parts of low skin, off its edges and the field's, that hold skin at rest."""
    inner = cv2.erode(low.astype(np.uint8), np.ones((5, 5), np.uint8), borderType=cv2.BORDER_CONSTANT, borderValue=0)
    border = int(2 * SMOOTHING)
    inner[:border], inner[-border:], inner[:, :border], inner[:, -border:] = 0, 0, 0, 0
    _, labels = cv2.connectedComponents(inner)
    numbers = np.unique(labels[resting & (inner > 0)])
    return np.asarray(np.isin(labels, numbers[numbers > 0]))


def _smooth(values: Float32Array) -> Float32Array:
    return np.asarray(cv2.GaussianBlur(values, (0, 0), SMOOTHING), np.float32)
