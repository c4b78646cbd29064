"""The presses levelled, and laid into one height map, weighted by 1/σ² and less towards their edges.

A press's own zero says nothing of the object: it is that of the skin around it, or none. So each press has one plane,
such that presses agree where they overlap, all together by least squares; height and tilt of the whole stay as the
presses have them in the mean. Each press is read once and added to sums on disk (memory maps), so that memory does not
grow with their number.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from device.align import Pose
from device.surface import Float32Array, Float64Array, MaskArray
from host_sync.errors import MosaicError
from host_sync.mosaic.presses import Fields, Press, Small
from host_sync.registration.fit import between_pixels, moved, reduced
from host_sync.results.field_file import MAX_PIXELS

BLOCKS: Final = 24
"""Blocks along the longer side of a press whose median differences are compared."""

FILLED: Final = 0.5
"""Least part of a block that both presses have."""

INDEPENDENT: Final = 9.0
"""An overlap counts as at most so many independent heights: errors of a press are long waves."""

MIN_SIGMA_UM: Final = 1e-3
ROUNDS: Final = 6
TUKEY: Final = 4.685
GAUGE: Final = 3
"""Height and two tilts of the whole, which no difference shows."""


@dataclass(frozen=True, slots=True, eq=False)
class Meeting:
    """Difference of two presses over their overlap, block by block.

    first, second : numbers of the presses
    here, there : float64 arrays of shape (N, 2), the blocks' middles in either press, px from its middle
    apart_um : float64 array of shape (N,), second less first
    sigma_um : float64 array of shape (N,), combined standard uncertainty of both heights there
    """

    first: int
    second: int
    here: Float64Array
    there: Float64Array
    apart_um: Float64Array
    sigma_um: Float64Array


@dataclass(frozen=True, slots=True, eq=False)
class Levels:
    """Planes that are added to the presses.

    planes : float64 array of shape (N, 3), height (µm) and slopes (µm per px, rows and columns) about the middles
    covariance : float64 array of shape (N, 3, 3) of each plane
    """

    planes: Float64Array
    covariance: Float64Array

    def apart_um(self, meeting: Meeting) -> Float64Array:
        """Return what still lies between two presses: float64 array of shape (blocks,)."""
        one, other = (self.planes[press] for press in (meeting.first, meeting.second))
        return np.asarray(
            meeting.apart_um + other[0] + meeting.there @ other[1:] - one[0] - meeting.here @ one[1:], np.float64
        )


def meeting(presses: list[Small], first: int, second: int, pose: Pose) -> Meeting:
    """Return the differences of two presses; pose: from the first to the second."""
    one, other = presses[first], presses[second]
    rows, columns = one.z_um.shape
    cells = one.in_cells(other, pose)
    apart = moved(other.z_um, cells, one.z_um.shape, 1) - one.z_um
    sigma = np.hypot(moved(other.sigma_um, cells, one.z_um.shape, 1), one.sigma_um)
    size = max(1, -(-max(rows, columns) // BLOCKS))
    places, values, sigmas = [], [], []
    for row in range(0, rows - size + 1, size):
        for column in range(0, columns - size + 1, size):
            block = apart[row : row + size, column : column + size]
            known = np.isfinite(block)
            if known.mean() < FILLED:
                continue
            places.append(one.centred((row + 0.5 * (size - 1), column + 0.5 * (size - 1))))
            values.append(float(np.median(block[known])))
            sigmas.append(float(np.nanmean(sigma[row : row + size, column : column + size])))
    here = np.array(places, np.float64).reshape(-1, 2)
    return Meeting(first, second, here, pose.of(here), np.array(values), _known(np.array(sigmas)))


def levelled(meetings: list[Meeting], presses: int, reach_px: float) -> Levels:
    """Return the planes of all presses.

    meetings : of the links in use; together they join the presses that have a place
    reach_px : half the diagonal of a press, to which tilts are scaled
    """
    count = 3 * presses
    solution, covariance = np.zeros(count), np.zeros((count, count))
    weights = [np.ones(len(one.apart_um)) for one in meetings]
    for _ in range(ROUNDS):
        normal, right = np.zeros((count, count)), np.zeros(count)
        chi, equations = 0.0, 0.0
        for one, weight in zip(meetings, weights, strict=True):
            design, columns = _design(one, reach_px)
            share = min(1.0, INDEPENDENT / max(len(weight), 1))
            trust = share * weight / one.sigma_um**2
            normal[np.ix_(columns, columns)] += design.T @ (trust[:, None] * design)
            right[columns] -= design.T @ (trust * one.apart_um)
            chi += float(trust @ (one.apart_um + design @ solution[columns]) ** 2)
            equations += share * float(weight.sum())
        inverse = _inverse(normal)
        solution = inverse @ right
        weights = [_tukey(_rest(one, solution, reach_px) / one.sigma_um) for one in meetings]
        covariance = inverse * max(chi / max(equations - count + GAUGE, 1.0), 1.0)
    scale = np.tile([1.0, 1.0 / reach_px, 1.0 / reach_px], presses)
    planes = (solution * scale).reshape(presses, 3)
    full = covariance * np.outer(scale, scale)
    blocks = np.stack([full[3 * one : 3 * one + 3, 3 * one : 3 * one + 3] for one in range(presses)])
    return Levels(planes, blocks)


def _design(one: Meeting, reach_px: float) -> tuple[Float64Array, list[int]]:
    """Return equations of a meeting, and the columns of the six unknowns that they are about."""
    ones = np.ones((len(one.apart_um), 1))
    design = np.hstack([-ones, -one.here / reach_px, ones, one.there / reach_px])
    return design, [*range(3 * one.first, 3 * one.first + 3), *range(3 * one.second, 3 * one.second + 3)]


def _rest(one: Meeting, solution: Float64Array, reach_px: float) -> Float64Array:
    design, columns = _design(one, reach_px)
    return np.asarray(one.apart_um + design @ solution[columns], np.float64)


def _tukey(off: Float64Array) -> Float64Array:
    """Return weights of residuals (in σ): 0 where they are no noise."""
    spread = TUKEY * max(1.4826 * float(np.median(np.abs(off))) if off.size else 1.0, 0.1)
    return np.asarray(np.clip(1.0 - (off / spread) ** 2, 0.0, None) ** 2, np.float64)


def _inverse(normal: Float64Array) -> Float64Array:
    """Return the inverse without the directions that no difference shows."""
    values, vectors = np.linalg.eigh(normal)
    determined = values > 1e-9 * max(float(values[-1]), 1e-30)
    determined[: min(GAUGE, len(determined))] = False
    turned = vectors[:, determined]
    return np.asarray((turned / values[determined]) @ turned.T, np.float64)


def _known(sigma_um: Float64Array) -> Float64Array:
    """Uncertainties, 1 µm where no press states any."""
    if not sigma_um.size or not (sigma_um > 0.0).any():
        return np.ones(sigma_um.shape)
    return np.maximum(sigma_um, MIN_SIGMA_UM)


CHUNK: Final = 1 << 20

Scalar = TypeVar("Scalar", bound=np.generic)


def disk_array(path: Path, dtype: type[Scalar], shape: tuple[int, int]) -> NDArray[Scalar]:
    """Return zeros in a new file, as a memory map of shape (H, W).

    A memory map of a file with holes ends the program without a word (SIGBUS) where the disk fills up.

    Raises
    ------
    OSError
        The disk has no room for it.
    """
    size = int(np.prod(shape)) * np.dtype(dtype).itemsize
    with path.open("wb") as stream:
        if hasattr(os, "posix_fallocate"):
            os.posix_fallocate(stream.fileno(), 0, size)
        else:
            for start in range(0, size, CHUNK):
                stream.write(bytes(min(CHUNK, size - start)))
    return np.memmap(path, dtype, "r+", shape=shape)


TAPER: Final = 0.1
"""Width over which the weight of a press falls to 0 towards its edge and its holes, fraction of its shorter side."""

TILE_ROWS: Final = 512
"""Rows of a press that are laid in at a time."""

UNKNOWN_SIGMA_UM: Final = 1.0


@dataclass(frozen=True, slots=True)
class Canvas:
    """The grid of a mosaic.

    shape : (H, W)
    step : px of a press along one of its pixels
    top, left : place of the middle of its first pixel in the mosaic, px of a press
    """

    shape: tuple[int, int]
    step: int
    top: float
    left: float


@dataclass(frozen=True, slots=True, eq=False)
class Blend:
    """The stitched fields, arrays of shape (H, W); float32 ones are memory maps.

    z_um, sigma_um : height and its standard uncertainty, NaN where no press is
    extrapolated : uint8, 1 where a press is extrapolated
    covered : fraction of the pixels that have a height
    """

    z_um: Float32Array
    sigma_um: Float32Array
    extrapolated: NDArray[np.uint8]
    covered: float


def canvas_of(places: list[Pose], shapes: list[tuple[int, int]], max_pixels: int = MAX_PIXELS) -> Canvas:
    """Return the grid that holds all presses, as fine as theirs where that is not too large.

    Raises
    ------
    MosaicError
        It is too large in any case.
    """
    corners = np.concatenate([place.of(_corners(shape)) for place, shape in zip(places, shapes, strict=True)])
    low, high = corners.min(axis=0), corners.max(axis=0)
    for step in range(1, 65):
        rows, columns = (int(np.floor((b - a) / step)) + 1 for a, b in zip(low, high, strict=True))
        if rows * columns <= max_pixels:
            return Canvas((rows, columns), step, float(low[0]), float(low[1]))
    raise MosaicError("the presses lie too far apart for one height map: choose fewer")


def _corners(shape: tuple[int, int]) -> Float64Array:
    half = 0.5 * (np.array(shape) - 1)
    return np.array([(row * half[0], column * half[1]) for row in (-1, 1) for column in (-1, 1)])


def blend(
    presses: list[Press],
    places: list[Pose],
    levels: Levels,
    canvas: Canvas,
    folder: Path,
    report_progress: Callable[[int], None] = lambda _: None,
) -> Blend:
    """Return the mosaic of the presses.

    levels : planes of these presses, in their order
    folder : for the sums
    report_progress : is called with the number of presses that are done

    Raises
    ------
    OSError
        The disk has no room for the sums.
    """

    def sums(name: str) -> Float32Array:
        return disk_array(folder / name, np.float32, canvas.shape)

    weight, height, sigma, level = (sums(f"{name}.sum") for name in ("weight", "height", "sigma", "level"))
    extrapolated = disk_array(folder / "extrapolated.sum", np.uint8, canvas.shape)
    for number, (press, place) in enumerate(zip(presses, places, strict=True)):
        source = _Source.of(press.read(), canvas.step)
        for window, local in _windows(canvas, place, press.shape):
            z_um, sigma_um, trust, beyond = source.at(*local)
            plane = levels.planes[number]
            row, column = (at - 0.5 * (size - 1) for at, size in zip(local, press.shape, strict=True))
            design = np.stack([np.ones_like(row), row, column], axis=-1)
            z_um = z_um + (design @ plane).astype(np.float32)
            variance = np.einsum("...i,ij,...j->...", design, levels.covariance[number], design).astype(np.float32)
            known = np.isfinite(z_um) & (trust > 0.0)
            trust = np.where(known, trust, np.float32(0.0))
            weight[window] += trust
            height[window] += trust * np.where(known, z_um, np.float32(0.0))
            sigma[window] += trust * np.where(known, sigma_um, np.float32(0.0))
            level[window] += trust * np.where(known, variance, np.float32(0.0))
            extrapolated[window] |= (beyond & known).astype(np.uint8)
        report_progress(number + 1)
    covered = 0
    for start in range(0, canvas.shape[0], TILE_ROWS):
        rows = slice(start, start + TILE_ROWS)
        total = weight[rows]
        known = total > 0.0
        covered += int(known.sum())
        over = np.where(known, total, np.float32(np.nan))
        height[rows] /= over
        # Presses of one calibration share errors: uncertainty is averaged, and not made smaller by their number.
        sigma[rows] = np.sqrt((sigma[rows] / over) ** 2 + level[rows] / over)
    del weight, level
    for name in ("weight", "level"):
        (folder / f"{name}.sum").unlink()
    return Blend(height, sigma, extrapolated, covered / (canvas.shape[0] * canvas.shape[1]))


def _windows(
    canvas: Canvas, place: Pose, shape: tuple[int, int]
) -> Iterator[tuple[tuple[slice, slice], tuple[Float32Array, Float32Array]]]:
    """Yield parts of the canvas that a press covers, and the places of their pixels in the press.

    Places are row and column, px of the press.
    """
    corners = (place.of(_corners(shape)) - (canvas.top, canvas.left)) / canvas.step
    low = np.maximum(np.floor(corners.min(axis=0)).astype(int), 0)
    high = np.minimum(np.ceil(corners.max(axis=0)).astype(int) + 1, canvas.shape)
    back = place.back()
    columns = slice(int(low[1]), int(high[1]))
    for start in range(int(low[0]), int(high[0]), TILE_ROWS):
        rows = slice(start, min(start + TILE_ROWS, int(high[0])))
        row, column = np.meshgrid(
            canvas.top + canvas.step * np.arange(rows.start, rows.stop),
            canvas.left + canvas.step * np.arange(columns.start, columns.stop),
            indexing="ij",
        )
        at = back.of(np.stack([row, column], axis=-1)) + 0.5 * (np.array(shape) - 1)
        yield (rows, columns), (at[..., 0].astype(np.float32), at[..., 1].astype(np.float32))


@dataclass(frozen=True, slots=True, eq=False)
class _Source:
    """A press, reduced to the step of the canvas, as it is laid in.

    z_um, sigma_um, trust, extrapolated : float32 arrays of shape (h, w)
    """

    z_um: Float32Array
    sigma_um: Float32Array
    trust: Float32Array
    extrapolated: Float32Array
    step: int

    @classmethod
    def of(cls, fields: Fields, step: int) -> _Source:
        z_um = reduced(fields.z_um, step)
        known = np.isfinite(z_um)
        sigma_um = np.full(z_um.shape, UNKNOWN_SIGMA_UM if fields.sigma_um is None else np.nan, np.float32)
        if fields.sigma_um is not None:
            sigma_um = reduced(fields.sigma_um, step)
        usual = float(np.nanmedian(sigma_um)) if np.isfinite(sigma_um).any() else UNKNOWN_SIGMA_UM
        sigma_um = np.where(np.isfinite(sigma_um) & (sigma_um > 0.0), sigma_um, np.float32(max(usual, 1e-3)))
        beyond = np.zeros(z_um.shape, np.float32)
        if fields.extrapolated is not None:
            beyond = reduced(fields.extrapolated.astype(np.float32), step)
        return cls(z_um, sigma_um, _taper(known) / sigma_um**2, beyond, step)

    def at(self, row: Float32Array, column: Float32Array) -> tuple[Float32Array, Float32Array, Float32Array, MaskArray]:
        """Return the height, uncertainty, weight and whether it is extrapolated at places (px of the press)."""
        row, column = (((at + 0.5) / self.step - 0.5).astype(np.float32) for at in (row, column))

        def between(values: Float32Array) -> Float32Array:
            found = cv2.remap(values, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0.0)
            return np.asarray(found, np.float32)

        z_um = between_pixels(self.z_um, row, column)
        return z_um, between(self.sigma_um), between(self.trust), between(self.extrapolated) > 0.0


def _taper(known: MaskArray) -> Float32Array:
    """1 inside a press, falling to 0 towards its edge and its holes: float32 array of shape (h, w)."""
    inside = np.zeros((known.shape[0] + 2, known.shape[1] + 2), np.uint8)
    inside[1:-1, 1:-1] = known
    away = cv2.distanceTransform(inside, cv2.DIST_L2, 3)[1:-1, 1:-1]
    share = np.clip(away / (TAPER * min(known.shape)), 0.0, 1.0)
    return np.asarray(share * share * (3.0 - 2.0 * share), np.float32)
