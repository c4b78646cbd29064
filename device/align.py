"""Shift and turn between two presses: poses in the plane, and a coarse search for one press in another.

Places are (row, column) from the middle of a press, in any one unit of length. A turn is clockwise on the screen.
The search correlates slopes of reduced maps over shift and turn. A correlation over an overlap of A pixels has a noise
of √A where the presses have nothing in common; the height of a peak over that noise ranks the places. Callers refine
and judge them.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import fft

from device.surface import Float32Array, Float64Array, MaskArray

QUARTER: Final = np.array([[0.0, 1.0], [-1.0, 0.0]])
"""Derivative of `turning` by its angle, at none."""


def turning(turn: float) -> Float64Array:
    """Return the rotation of places (row, column) by `turn` (rad): float64 array of shape (2, 2)."""
    cosine, sine = np.cos(turn), np.sin(turn)
    return np.array([[cosine, sine], [-sine, cosine]])


@dataclass(frozen=True, slots=True)
class Pose:
    """Shift and turn that lead from places u of one press to places s + M(turn) u of another, or of a mosaic.

    down, right : the shift s, in the unit of the places, mostly px
    turn : rad
    """

    down: float = 0.0
    right: float = 0.0
    turn: float = 0.0

    def of(self, places: ArrayLike) -> Float64Array:
        """Return where places, an array of shape (…, 2), lie."""
        return np.asarray(places) @ turning(self.turn).T + (self.down, self.right)

    def then(self, other: Pose) -> Pose:
        """Return this pose and the other after it as one."""
        down, right = other.of((self.down, self.right))
        return Pose(float(down), float(right), self.turn + other.turn)

    def back(self) -> Pose:
        """Return the inverse pose."""
        return Pose(-self.down, -self.right).then(Pose(turn=-self.turn))

    def moved_by(self, down: float, right: float, turn: float = 0.0) -> Pose:
        """Return the pose with this added to its shift and turn."""
        return Pose(float(self.down + down), float(self.right + right), float(self.turn + turn))

    def in_units_of(self, length: float) -> Pose:
        """Return the same pose of places in another unit, whose length is given in the present one."""
        return Pose(float(self.down / length), float(self.right / length), self.turn)

    def distance(self, other: Pose, reach: float) -> float:
        """Return the largest distance between the places of a point by either pose, to first order.

        reach : distance of the farthest point from the middle
        """
        turn = (self.turn - other.turn + np.pi) % (2.0 * np.pi) - np.pi
        return float(np.hypot(self.down - other.down, self.right - other.right) + reach * abs(turn))

    def distance_at(self, other: Pose, place: tuple[float, float]) -> float:
        """Return the distance between where both put a place."""
        return float(np.hypot(*(self.of(place) - other.of(place))))


SMOOTHED_PX: Final = 0.7
LONG_WAVE_PX: Final = 5.0
"""Slopes are taken from their mean over about this: tilt and bow of a press are no place."""

APART_PX: Final = 4.0
APART_DEG: Final = 8.0
"""Places closer than both are one."""

KNOWN: Final = 0.99
Complex = NDArray[np.complex64]


@dataclass(frozen=True, slots=True)
class Place:
    """Possible place of a map in another.

    pose : from the first to the second, between their middles, px
    rank : height of the correlation's peak over its root mean square
    """

    pose: Pose
    rank: float


def relief_slopes(z_um: Float32Array) -> tuple[Complex, float]:
    """Return slopes p + iq, array of shape (h, w), and their root mean square before they are scaled, µm a pixel.

    They have no long waves and a root mean square of 1, beyond which they are clipped: one steep edge decides nothing.
    They are 0 where the height map is invalid.
    """
    q, p = np.gradient(cv2.GaussianBlur(z_um, (0, 0), SMOOTHED_PX))
    slopes = np.asarray(p + 1j * q, np.complex64)
    known = np.isfinite(slopes)
    slopes = np.where(known, slopes, np.complex64(0.0))
    part = cv2.GaussianBlur(known.astype(np.float32), (0, 0), LONG_WAVE_PX) + np.float32(1e-6)
    wave = [cv2.GaussianBlur(one, (0, 0), LONG_WAVE_PX) / part for one in (slopes.real, slopes.imag)]
    slopes = np.where(known, slopes - (wave[0] + 1j * wave[1]), np.complex64(0.0))
    size = np.abs(slopes)
    mean = float(np.sqrt(np.mean(size[known] ** 2))) if known.any() else 0.0
    return np.asarray(slopes / np.maximum(size, max(mean, 1e-12)), np.complex64), mean


def seen_at(slopes: Complex, pose: Pose, shape: tuple[int, ...]) -> tuple[Complex, MaskArray]:
    """Return the slopes of a map at the pixels of another, and where they are known: arrays of its shape (h, w)."""
    matrix = turning(-pose.turn)  # OpenCV's places are (column, row)
    there, here = (0.5 * (np.array(sizes[1::-1]) - 1.0) for sizes in (slopes.shape, shape))
    offset = np.add(there, (pose.right, pose.down)) - matrix @ here
    planes = np.dstack([slopes.real, slopes.imag, np.ones(slopes.shape, np.float32)])
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    moved = cv2.warpAffine(planes, np.column_stack([matrix, offset]), (shape[1], shape[0]), flags=flags)
    known = np.asarray(moved[..., 2] > KNOWN, np.bool_)
    back = np.complex64(np.exp(-1j * pose.turn))
    return np.where(known, (moved[..., 0] + 1j * moved[..., 1]) * back, np.complex64(0.0)), known


class PlaceSearch:
    """Search over all shifts with enough overlap, and a set of turns.

    shape : (h, w) that slopes are cut or padded to, about their middle
    turns_deg : of the second map
    min_overlap : least overlap, as a fraction of the shape
    """

    def __init__(self, shape: tuple[int, ...], turns_deg: Iterable[float], min_overlap: float) -> None:
        self._shape = shape
        self._turns = [Pose(turn=float(np.radians(turn))) for turn in turns_deg]
        self._size = [fft.next_fast_len(2 * size) for size in shape]
        self._shifts = np.meshgrid(*(fft.fftfreq(size, 1.0 / size) for size in self._size), indexing="ij", sparse=True)
        sides = [np.maximum(size - np.abs(shift), 0.0) for size, shift in zip(shape, self._shifts, strict=True)]
        area = sides[0] * sides[1]
        self._enough = area >= min_overlap * shape[0] * shape[1]
        self._noise = np.sqrt(np.maximum(area, 1.0)).astype(np.float32)

    def first(self, slopes: Complex) -> Complex:
        """Return the spectrum of a map in which others are sought."""
        return np.asarray(np.conj(fft.fft2(seen_at(slopes, Pose(), self._shape)[0], self._size)), np.complex64)

    def second(self, slopes: Complex) -> list[Complex]:
        """Return the spectra of a map that is sought in others, of each turn."""
        return [fft.fft2(seen_at(slopes, turn, self._shape)[0], self._size) for turn in self._turns]

    def places(
        self, first: Complex, second: list[Complex], count: int, near: tuple[Float64Array, float] | None = None
    ) -> list[Place]:
        """Return so many places of a map in another, best first.

        first, second : spectra of both
        near : where the first's middle lies in the second (row and column from its middle, px), and how far off that is
        """
        scores = np.stack([fft.ifft2(first * spectrum).real for spectrum in second]) / self._noise
        scores /= np.sqrt(np.mean(scores * scores, where=self._enough)) or 1.0
        peaks = [
            peak
            for turn, score in zip(self._turns, scores, strict=True)
            for peak in self._peaks(score, turn, count, near)
        ]
        distinct: list[Place] = []
        for peak in sorted(peaks, key=lambda one: -one.rank):
            if len(distinct) < count and all(is_apart(peak.pose, one.pose) for one in distinct):
                distinct.append(peak)
        return distinct

    def _peaks(
        self, score: Float32Array, turn: Pose, count: int, near: tuple[Float64Array, float] | None
    ) -> Iterable[Place]:
        """Yield the highest places of one turn."""
        down, right = self._shifts
        allowed = self._enough
        if near is not None:
            expected = turn.back().of(near[0])
            allowed = allowed & (np.hypot(down - expected[0], right - expected[1]) <= near[1])
            # A relief that repeats has peaks all around: each turn counts by its own spread there.
            score = score / (np.sqrt(np.sum(score * score, where=allowed) / max(np.count_nonzero(allowed), 1)) or 1.0)
        score = np.where(allowed, score, np.float32(-np.inf))
        for _ in range(count):
            row, column = np.unravel_index(int(np.argmax(score)), score.shape)
            if not np.isfinite(rank := float(score[row, column])):
                return
            peak = down[row, 0], right[0, column]
            yield Place(Pose(*peak).then(turn), rank)
            score[(np.abs(down - peak[0]) <= APART_PX) & (np.abs(right - peak[1]) <= APART_PX)] = -np.inf


def is_apart(one: Pose, other: Pose) -> bool:
    """Return whether two places are two, px."""
    return one.distance(other, 0.0) > APART_PX or abs(one.turn - other.turn) > np.radians(APART_DEG)
