"""Poses of one height map relative to another, where their search starts, and the second map at pixels of the first."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from device.surface.fields import Float32Array, Float64Array, HeightMap
from host_sync.errors import ViewError
from host_sync.kernels.jit import njit

MAX_SIDE_PX: Final = 32_000


@dataclass(frozen=True, slots=True)
class Pose:
    """Displacement of the object in the second map, in pixels of the first: rotation about the centre, then shift.

    down, right : px
    turn : clockwise on the screen, rad
    """

    down: float = 0.0
    right: float = 0.0
    turn: float = 0.0

    def distance_px(self, other: Pose, shape: tuple[int, ...]) -> float:
        """Return the largest distance between the places of a map's corner by either pose, to first order.

        shape : of the map, (H, W)
        """
        reach = 0.5 * float(np.hypot(shape[0], shape[1]))
        return float(np.hypot(self.down - other.down, self.right - other.right) + reach * abs(self.turn - other.turn))

    def distance_at(self, other: Pose, place: tuple[float, float]) -> float:
        """Return the distance between where both poses put a place (row, column from the middle of the map), px."""
        ends = self.place_of(place), other.place_of(place)
        return float(np.hypot(ends[0][0] - ends[1][0], ends[0][1] - ends[1][1]))

    def place_of(self, place: tuple[float, float]) -> tuple[float, float]:
        """Return where a place of the first map (row, column from its middle, px) lies in the second."""
        cosine, sine = float(np.cos(self.turn)), float(np.sin(self.turn))
        return self.down + cosine * place[0] + sine * place[1], self.right - sine * place[0] + cosine * place[1]

    def moved_by(self, change: Float64Array) -> Pose:
        """Return the pose plus (down, right, turn)."""
        down, right, turn = (float(value) for value in change)
        return Pose(self.down + down, self.right + right, self.turn + turn)


def at_pitch(height: HeightMap, pitch_um: float) -> Float32Array:
    """Return the height map resampled to another pitch.

    Raises
    ------
    ViewError
        The pitches differ too much.
    """
    factor = height.pitch_um / pitch_um
    if abs(factor - 1.0) < 1e-3:
        return height.z_um
    size = (max(2, round(height.z_um.shape[1] * factor)), max(2, round(height.z_um.shape[0] * factor)))
    if max(size) > MAX_SIDE_PX:
        raise ViewError("the pixel pitches of the two scans differ too much: compare scans of one kind of device")
    way = cv2.INTER_AREA if factor < 1.0 else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(height.z_um, size, interpolation=way), np.float32)


def moved(small: Float32Array, pose: Pose, shape: tuple[int, ...], step: int) -> Float32Array:
    """Return the second map at the pixels of the first; NaN outside it and beside its holes.

    small : the second map, reduced by `step`
    shape : of the first map, reduced by `step`
    """
    full = (shape[0] * step, shape[1] * step)
    row, column = centred(shape, full, step)
    at_row = 0.5 * (full[0] - 1) + pose.down + np.cos(pose.turn) * row + np.sin(pose.turn) * column
    at_column = 0.5 * (full[1] - 1) + pose.right - np.sin(pose.turn) * row + np.cos(pose.turn) * column
    down, right = (((at + 0.5) / step - 0.5).astype(np.float32) for at in (at_row, at_column))
    return between_pixels(small, down, right)


def centred(shape: tuple[int, ...], full: tuple[int, ...], step: int) -> tuple[Float32Array, Float32Array]:
    """Return rows and columns of the cell centres relative to the map's centre, px of the full map: arrays (h, w)."""
    places = [
        ((np.arange(count) + 0.5) * step - 0.5 - 0.5 * (whole - 1)).astype(np.float32)
        for count, whole in zip(shape[:2], full[:2], strict=True)
    ]
    row, column = np.meshgrid(*places, indexing="ij")
    return row, column


def reduced(z_um: Float32Array, step: int) -> Float32Array:
    """Return means over squares of `step` pixels; rows and columns beyond the last whole square are dropped."""
    if step == 1:
        return z_um
    rows, columns = (size // step for size in z_um.shape)
    part = z_um[: rows * step, : columns * step]
    return np.asarray(cv2.resize(part, (columns, rows), interpolation=cv2.INTER_AREA), np.float32)


def between_pixels(z_um: Float32Array, row: Float32Array, column: Float32Array) -> Float32Array:
    """Return heights at places (px) by cubic convolution: float32 array of the places' shape.

    NaN where one of the 4 × 4 neighbours is invalid or outside. OpenCV's remap resolves places to 1/32 pixel only.
    """
    found = np.empty(row.shape, np.float32)
    _convolve(np.ascontiguousarray(z_um), np.ascontiguousarray(row), np.ascontiguousarray(column), found)
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def _weights(t: Any) -> Any:
    """Return weights of the pixels at -1, 0, 1 and 2 for a place at fraction `t` of a pixel."""
    t2, t3 = t * t, t * t * t
    return (
        np.float32(0.5 * (-t3 + 2.0 * t2 - t)),
        np.float32(0.5 * (3.0 * t3 - 5.0 * t2 + 2.0)),
        np.float32(0.5 * (-3.0 * t3 + 4.0 * t2 + t)),
        np.float32(0.5 * (t3 - t2)),
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _convolve(z_um: Any, row: Any, column: Any, found: Any) -> None:
    """Write the heights."""
    rows, columns = z_um.shape
    for r in range(found.shape[0]):
        for c in range(found.shape[1]):
            at_row, at_column = int(np.floor(row[r, c])), int(np.floor(column[r, c]))
            if at_row < 1 or at_column < 1 or at_row + 2 >= rows or at_column + 2 >= columns:
                found[r, c] = np.nan
                continue
            down = _weights(row[r, c] - np.float32(at_row))
            right = _weights(column[r, c] - np.float32(at_column))
            total = np.float32(0.0)
            for i in range(4):
                line = np.float32(0.0)
                for j in range(4):
                    line += right[j] * z_um[at_row - 1 + i, at_column - 1 + j]
                total += down[i] * line
            found[r, c] = total


# Starts of a registration: the best places of several correlations over shift and rotation.
#
# Each correlation can be led astray by itself: slopes by an object that slides along itself, the rim of contact by
# another depth, the texture of the frames by what is fixed to the gel. So all of them give starts, and none decides.

COARSE_PX: Final = 120
TURNS_DEG: Final = tuple(range(-24, 25, 3))
KEPT: Final = 5
"""Starts of each correlation over all rotations."""

MIN_SHARE: Final = 0.25
"""Least part of either map's slope energy that must overlap."""

SMOOTHED_PX: Final = 1.5
RIM_SHARE: Final = 0.25
"""Of the map's height, above which skin counts as pressed."""

TEXTURE_PX: Final = 768
APART_PX: Final = 3
"""Places of one correlation closer than this are one, coarse pixels."""

Complex = NDArray[np.complex128]


@dataclass(frozen=True, slots=True)
class Start:
    """A pose to start from: what it was found by, and the correlation there."""

    pose: Pose
    by: str
    score: float


def starts(first: Float32Array, second: Float32Array) -> list[Start]:
    """Return starts from relief and rim, best first within each."""
    step = max(1, int(np.ceil(max(*first.shape, *second.shape) / COARSE_PX)))
    small = [reduced(z_um, step) for z_um in (first, second)]
    found = [Start(Pose(), "as they lie", 0.0)]
    for by, (one, other) in (("relief", small), ("rim", [_rim(z_um) for z_um in small])):
        every = sorted(_over_turns(one, other, step, by), key=lambda one: -one.score)
        found += every[:KEPT]
        found += [one for one in every[KEPT:] if one.pose.turn == 0.0][:1]
    return found


def texture_starts(frames: tuple[Float32Array, Float32Array]) -> list[Start]:
    """Return starts from the texture of two frames of one gel, grey arrays (H, W) of one size, without rotation."""
    step = max(1, int(np.ceil(max(frames[0].shape) / TEXTURE_PX)))
    fields = []
    for frame in frames:
        small = reduced(frame, step)
        fine = np.log(np.maximum(small, np.float32(1e-4)))
        fine = fine - cv2.GaussianBlur(fine, (0, 0), 6.0)
        fields.append(np.nan_to_num(fine))
    shape = _padded(fields[0].shape, fields[1].shape)
    spectra = [np.fft.fft2(field, shape) for field in fields]
    cross = np.conj(spectra[0]) * spectra[1]
    size = np.abs(cross)
    if not size.max() > 0.0:
        return []
    peak = np.fft.ifft2(cross / (size + 1e-3 * size.max())).real
    return [Start(Pose(down * step, right * step), "texture", score) for down, right, score in _peaks(peak, 2)]


def _over_turns(first: Float32Array, second: Float32Array, step: int, by: str) -> Iterator[Start]:
    one = _slopes(first)
    for turn_deg in TURNS_DEG:
        turn = float(np.radians(turn_deg))
        # The second map turned back about the middle of the first's field.
        other = _slopes(moved(second, Pose(0.0, 0.0, turn), second.shape, 1))
        for down, right, score in _peaks(_agreement(one, other), 2):
            # A shift in the turned frame is one of the object in the second map, turned.
            cosine, sine = np.cos(turn), np.sin(turn)
            middle = [0.5 * (b - a) for a, b in zip(first.shape, second.shape, strict=True)]
            row, column = down - middle[0], right - middle[1]
            pose = Pose(
                step * float(middle[0] + cosine * row + sine * column),
                step * float(middle[1] - sine * row + cosine * column),
                turn,
            )
            yield Start(pose, by, score)


def _agreement(one: Complex, other: Complex) -> Float64Array:
    """Return the correlation of the slopes over their overlap for each whole shift, in the padded shape.

    It is -1 where the overlap is too small.
    """
    shape = _padded(one.shape, other.shape)
    squares = [np.abs(field) ** 2 for field in (one, other)]
    inside = [np.ones(field.shape) for field in (one, other)]

    def correlated(a: NDArray[np.generic], b: NDArray[np.generic]) -> Complex:
        return np.asarray(np.fft.ifft2(np.conj(np.fft.fft2(a, shape)) * np.fft.fft2(b, shape)))

    product = correlated(one, other).real
    energies = correlated(squares[0], inside[1]).real, correlated(inside[0], squares[1]).real
    enough = (energies[0] > MIN_SHARE * squares[0].sum()) & (energies[1] > MIN_SHARE * squares[1].sum())
    with np.errstate(divide="ignore", invalid="ignore"):
        found = 2.0 * product / (energies[0] + energies[1])
    return np.where(enough & np.isfinite(found), found, -1.0)


def _peaks(field: Float64Array, count: int) -> Iterator[tuple[int, int, float]]:
    """Yield the shift (rows, columns) and value of the highest places of a periodic field, `APART_PX` apart."""
    left = field.copy()
    rows, columns = field.shape
    for _ in range(count):
        down, right = (int(place) for place in np.unravel_index(int(np.argmax(left)), field.shape))
        score = float(left[down, right])
        if score <= -1.0:
            return
        yield down - rows if down > rows // 2 else down, right - columns if right > columns // 2 else right, score
        near = [(np.arange(-APART_PX, APART_PX + 1) + at) % size for at, size in ((down, rows), (right, columns))]
        left[np.ix_(*near)] = -1.0


def _padded(one: tuple[int, ...], other: tuple[int, ...]) -> tuple[int, int]:
    rows, columns = (cv2.getOptimalDFTSize(one[axis] + other[axis]) for axis in (0, 1))
    return rows, columns


def _slopes(z_um: Float32Array) -> Complex:
    """p + iq, smoothed, 0 where invalid: complex array of shape (h, w)."""
    q, p = np.gradient(cv2.GaussianBlur(z_um, (0, 0), SMOOTHED_PX))
    slopes = p + 1j * q
    return np.asarray(np.where(np.isfinite(slopes), slopes, 0.0), np.complex128)


def _rim(z_um: Float32Array) -> Float32Array:
    """1 where the skin is pressed, 0 elsewhere, NaN where invalid: float32 array of shape (h, w)."""
    known = z_um[np.isfinite(z_um)]
    if not known.size:
        return z_um
    low, high = np.percentile(known, [5.0, 99.0])
    pressed = (z_um > low + RIM_SHARE * (high - low)).astype(np.float32)
    return np.where(np.isfinite(z_um), pressed, np.float32(np.nan)).astype(np.float32)
