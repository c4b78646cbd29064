"""Candidates for overlaps: correlation of the slopes of strongly reduced presses over shift and turn.

A correlation over an overlap of A pixels has a noise of √A where the presses have nothing in common; the height of a
peak over that noise ranks what `links` verifies.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import fft

from device.surface.fields import Float32Array, Float64Array
from host_sync.csv_table import number_in, read_table
from host_sync.errors import MosaicError
from host_sync.mosaic.presses import Press, Small
from host_sync.registration.poses import Pose, moved, reduced

COARSE_PX: Final = 128
TURNS_DEG: Final = tuple(range(-12, 13, 2))
SMOOTHED_PX: Final = 0.7
LONG_WAVE_PX: Final = 5.0
"""Slopes are taken from their mean over about this, coarse px: a press's own bow is no overlap."""

CLIPPED: Final = 1.0
"""Slopes beyond so many times their root mean square count as that: one steep edge decides nothing."""

MIN_OVERLAP: Final = 0.07
"""Least overlap that is looked for, as a fraction of the field."""

PEAKS: Final = 4
"""Places of one pair that are verified."""

PARTNERS: Final = 16
"""Presses that one press is verified with, at most: the best ranked."""

APART_PX: Final = 4
Complex = NDArray[np.complex64]


@dataclass(frozen=True, slots=True)
class Candidate:
    """Possible place of a press in another.

    first, second : numbers of the presses
    motion : from the first to the second
    rank : height of the peak over the noise
    """

    first: int
    second: int
    motion: Motion
    rank: float


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """Stated places of presses.

    places_px : float64 array of shape (N, 2), their middles (row, column)
    within_px : how far off that may be
    """

    places_px: Float64Array
    within_px: float


def candidates(presses: list[Small], layout: Layout | None = None) -> list[Candidate]:
    """Return what is worth verifying, best first."""
    step = max(1, -(-max(max(press.z_um.shape) for press in presses) // COARSE_PX))
    coarse = [reduced(press.z_um, step) for press in presses]
    px = step * presses[0].step
    rows, columns = (max(z_um.shape[axis] for z_um in coarse) for axis in (0, 1))
    shape = (fft.next_fast_len(2 * rows), fft.next_fast_len(2 * columns))
    allowed, inverse_noise = _overlap(rows, columns, shape)
    straight = [np.conj(fft.fft2(coarse_slopes(z_um), shape)) for z_um in coarse]
    turns = [float(np.radians(turn)) for turn in TURNS_DEG]
    found: list[Candidate] = []
    for second, other in enumerate(coarse):
        turned = [fft.fft2(coarse_slopes(moved(other, Pose(0.0, 0.0, turn), other.shape, 1)), shape) for turn in turns]
        for first in range(second):
            near = allowed
            if layout is not None:
                near = allowed & _near(layout, first, second, px, shape)
                if not near.any():
                    continue
            scores = (fft.ifft2(straight[first] * spectrum).real * inverse_noise for spectrum in turned)
            found += _best((first, second), scores, turns, near, px)
    return _chosen(found, len(presses))


def _overlap(rows: int, columns: int, shape: tuple[int, int]) -> tuple[NDArray[np.bool_], Float32Array]:
    """Return for each shift whether enough overlaps, and one over the noise of the correlation."""
    down, right = (np.minimum(np.arange(size), size - np.arange(size)) for size in shape)
    area = np.maximum(rows - down, 0)[:, None] * np.maximum(columns - right, 0)[None, :]
    enough = area >= MIN_OVERLAP * rows * columns
    return enough, np.asarray(np.where(enough, 1.0 / np.sqrt(np.maximum(area, 1)), 0.0), np.float32)


def _near(layout: Layout, first: int, second: int, px: int, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Return shifts that the layout allows: where the first's middle lies in the second."""
    expected = (layout.places_px[first] - layout.places_px[second]) / px
    reach = layout.within_px / px + 1.0
    off = []
    for axis, size in enumerate(shape):
        at = np.arange(size)
        off.append(np.where(at > size // 2, at - size, at) - expected[axis])
    return np.asarray(np.hypot(off[0][:, None], off[1][None, :]) <= reach)


def _best(
    pair: tuple[int, int],
    scores: Iterable[Float32Array],
    turns: list[float],
    near: NDArray[np.bool_],
    px: int,
) -> list[Candidate]:
    """Return the best places of one pair over all turns."""
    peaks: list[tuple[float, int, int, float]] = []
    for turn, score in zip(turns, scores, strict=True):
        spread = float(np.sqrt(np.mean(score * score, where=near))) or 1.0
        field = np.where(near, score / np.float32(spread), np.float32(-np.inf))
        for _ in range(PEAKS):
            down, right = (int(at) for at in np.unravel_index(int(np.argmax(field)), field.shape))
            rank = float(field[down, right])
            if not np.isfinite(rank):
                break
            down_px, right_px = (
                at - size if at > size // 2 else at for at, size in zip((down, right), field.shape, strict=True)
            )
            peaks.append((rank, down_px, right_px, turn))
            around = [
                (np.arange(-APART_PX, APART_PX + 1) + at) % size
                for at, size in zip((down, right), field.shape, strict=True)
            ]
            field[np.ix_(*around)] = -np.inf
    kept: list[Candidate] = []
    for rank, down_px, right_px, turn in sorted(peaks, reverse=True):
        # A shift in the turned frame is one of the object in the second press, turned.
        away = turning(turn) @ (down_px * px, right_px * px)
        motion = Motion(float(away[0]), float(away[1]), turn)
        if all(motion.distance_px(one.motion, 0.0) > APART_PX * px for one in kept):
            kept.append(Candidate(*pair, motion, rank))
        if len(kept) == PEAKS:
            break
    return kept


def _chosen(found: list[Candidate], count: int) -> list[Candidate]:
    """Return the best ranked, best first, so that no press is verified with too many."""
    seen = np.zeros(count, int)
    chosen = []
    for one in sorted(found, key=lambda one: -one.rank):
        if min(seen[one.first], seen[one.second]) < PARTNERS:
            seen[[one.first, one.second]] += 1
            chosen.append(one)
    return chosen


def coarse_slopes(z_um: Float32Array) -> Complex:
    """p + iq without long waves, of mean square 1, clipped, 0 where invalid: complex64 array of shape (h, w)."""
    q, p = np.gradient(cv2.GaussianBlur(z_um, (0, 0), SMOOTHED_PX))
    slopes = np.asarray(p + 1j * q, np.complex64)
    known = np.isfinite(slopes)
    if not known.any():
        return np.zeros(z_um.shape, np.complex64)
    slopes = np.where(known, slopes - slopes[known].mean(), np.complex64(0.0))
    share = cv2.GaussianBlur(known.astype(np.float32), (0, 0), LONG_WAVE_PX) + np.float32(1e-6)
    wave = cv2.GaussianBlur(slopes.real, (0, 0), LONG_WAVE_PX) + 1j * cv2.GaussianBlur(
        slopes.imag, (0, 0), LONG_WAVE_PX
    )
    slopes = np.where(known, slopes - wave / share, np.complex64(0.0))
    size = np.abs(slopes)
    mean = max(float(np.sqrt(np.mean(size[known] ** 2))), 1e-12)
    return np.asarray(slopes / np.maximum(size / CLIPPED, mean), np.complex64)


COLUMNS: Final = ("scan", "right_mm", "down_mm")


def read_layout(path: Path, presses: list[Press], within_mm: float) -> Layout:
    """Return the layout of the presses.

    within_mm : how far off it may be

    Raises
    ------
    MosaicError
        The file cannot be read, or does not hold every press.
    """
    if not within_mm > 0.0:
        raise MosaicError(f"--within-mm {within_mm:g}: is no length: give a positive number")
    places = {}
    for number, row in enumerate(read_table(path, MosaicError), start=2):
        place = [number_in(row.get(name, "")) for name in COLUMNS[1:]]
        if "scan" not in row or not np.isfinite(place).all():
            raise MosaicError(f"{path}: line {number}: needs {', '.join(COLUMNS)}, the last two finite numbers")
        places[row["scan"]] = place[::-1]
    missing = [press.name for press in presses if press.name not in places]
    if missing:
        raise MosaicError(f"{path}: holds no line for {missing[0]}: add one for each scan")
    per_mm = 1e3 / presses[0].record.pixel_pitch_um
    return Layout(np.array([places[press.name] for press in presses], np.float64) * per_mm, within_mm * per_mm)


# Rigid motions in the plane: where a place of one press lies in another, and in the mosaic.
#
# Places are (row, column), px, from the middle of a press. A turn is clockwise on the screen, as for `Pose`.

QUARTER: Final = np.array([[0.0, 1.0], [-1.0, 0.0]])
"""Derivative of `turning` by its angle, at none."""


def turning(turn: float) -> Float64Array:
    """Return the rotation of places (row, column) by `turn` (rad): float64 array of shape (2, 2)."""
    cosine, sine = np.cos(turn), np.sin(turn)
    return np.array([[cosine, sine], [-sine, cosine]])


@dataclass(frozen=True, slots=True)
class Motion:
    """From places u of one press to places s + M(turn) u of another; also of a press to the mosaic.

    down, right : px
    turn : rad
    """

    down: float = 0.0
    right: float = 0.0
    turn: float = 0.0

    def of(self, places: Float64Array) -> Float64Array:
        """Return where places, an array of shape (…, 2), lie."""
        return np.asarray(places @ turning(self.turn).T + (self.down, self.right), np.float64)

    def then(self, other: Motion) -> Motion:
        """Return this motion and the other after it."""
        down, right = other.of(np.array([self.down, self.right]))
        return Motion(float(down), float(right), self.turn + other.turn)

    def back(self) -> Motion:
        """Return the inverse motion."""
        down, right = -(turning(-self.turn) @ (self.down, self.right))
        return Motion(float(down), float(right), -self.turn)

    def distance_px(self, other: Motion, reach_px: float) -> float:
        """Return the largest distance between the places of a point by either motion, to first order.

        reach_px : distance of the farthest point from the middle
        """
        turn = (self.turn - other.turn + np.pi) % (2.0 * np.pi) - np.pi
        return float(np.hypot(self.down - other.down, self.right - other.right) + reach_px * abs(turn))
