"""Place of the instrument relative to an earlier press: shift and turn of two quick looks, or no answer.

Slopes without long waves, strongly reduced, are correlated over shift and turn with FFTs; the best places are verified
over their true overlap. An answer needs a peak far above the noise and no other place nearly as good: guidance that is
silent costs a touch, guidance that points away costs trust. The workstation registers again and decides.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from device.imaging.flat_field import bin_bayer
from device.quick_look.solver import QuickLookModel, quick_look
from device.surface.fields import Float32Array, HeightMap
from hal.frame import RawFrame

COARSE_PX: Final = 96
"""Columns of the reduced slopes."""

TURNS_DEG: Final = tuple(range(-30, 31, 3))
SMOOTHED_PX: Final = 0.7
LONG_WAVE_PX: Final = 6.0
"""Slopes are taken from their mean over about this, reduced pixels: tilt and bow of a press are no place."""

MIN_SLOPE: Final = 0.004
"""Least root mean square of the reduced slopes, µm/µm: below it the skin shows the calibration's errors."""

MIN_OVERLAP: Final = 0.12
"""Least overlap that is looked for, as a fraction of the field."""

MIN_RANK: Final = 30.0
"""Least peak over the noise of independent pixels. Slopes of neighbouring pixels are alike: presses without anything in
common reach 20 to 40, and those with half a field 70."""

MIN_AGREEMENT: Final = 0.6
"""Least correlation coefficient of the slopes over the overlap: at most 0.5 by chance, else above 0.9."""

NEXT_BEST: Final = 0.75
"""A place elsewhere whose peak is higher than this fraction of the best one's makes the answer unknown."""

APART_PX: Final = 3.5
APART_DEG: Final = 8.0
"""Places closer than both are one."""

VERIFIED: Final = 6
_NEAR: Final = 3
_FIRST_STEP_DEG: Final = 1.5
_ROUNDS: Final = 3
_SIGMA_PX: Final = 0.25
_SIGMA_DEG: Final = 0.4
"""Stated uncertainties: about twice the errors of simulated touches (`tests/device/guidance/test_placement.py`)."""

Complex = NDArray[np.complex64]


@dataclass(frozen=True, slots=True)
class Placement:
    """Present place of the instrument relative to an earlier press, as the way back.

    right_mm, down_mm : move by this in the live view's directions brings its middle onto the earlier one's
    clockwise_deg : then turn by this, seen from behind the instrument
    shift_sigma_mm, turn_sigma_deg : standard uncertainties
    overlap : fraction of the field that both see
    peak_to_noise : height of the correlation over what presses without anything in common reach
    """

    right_mm: float
    down_mm: float
    clockwise_deg: float
    shift_sigma_mm: float
    turn_sigma_deg: float
    overlap: float
    peak_to_noise: float

    @property
    def distance_mm(self) -> float:
        """Length of the way back."""
        return float(np.hypot(self.right_mm, self.down_mm))


@dataclass(frozen=True, slots=True)
class Unplaced:
    """Why there is no answer, as a sentence for people."""

    reason: str


@dataclass(frozen=True, slots=True)
class _Place:
    """A shift (reduced pixels, in the turned live view) and a turn (rad) with rank, agreement and overlap."""

    right: float
    down: float
    turn: float
    rank: float
    agreement: float = 0.0
    overlap: float = 0.0


class Target:
    """An earlier press, prepared once: every live quick look is placed against it."""

    def __init__(self, height: HeightMap) -> None:
        self._pitch_um = height.z_um.shape[1] * height.pitch_um / COARSE_PX
        self._slopes, self._relief = _slopes(height, self._pitch_um)
        rows, columns = self._slopes.shape
        self._size = cv2.getOptimalDFTSize(2 * rows), cv2.getOptimalDFTSize(2 * columns)
        self._spectrum = np.conj(np.fft.fft2(self._slopes, self._size))
        down, right = (np.minimum(np.arange(size), size - np.arange(size)) for size in self._size)
        area = np.maximum(rows - down, 0)[:, None] * np.maximum(columns - right, 0)[None, :]
        enough = area >= MIN_OVERLAP * rows * columns
        self._inverse_noise = np.where(enough, 1.0 / np.sqrt(np.maximum(area, 1)), 0.0).astype(np.float32)

    def place(self, live: HeightMap) -> Placement | Unplaced:
        """Return the way from where `live` was taken to this press."""
        slopes, relief = _slopes(live, self._pitch_um)
        if min(relief, self._relief) < MIN_SLOPE:
            return Unplaced("too little relief to know where this is: press a little deeper")
        rows, columns = self._slopes.shape
        slopes = _fitted(slopes, (rows, columns))
        found = self._verified(slopes)
        best = self._refined(found[0], slopes)
        if best.rank < MIN_RANK or best.agreement < MIN_AGREEMENT:
            return Unplaced("not recognised: touch nearer to the earlier place")
        if any(_apart(found[0], one) and one.rank > NEXT_BEST * found[0].rank for one in found[1:]):
            return Unplaced("the relief looks alike at several places: touch where it is more distinct")
        cosine, sine = np.cos(best.turn), np.sin(best.turn)
        mm = 1e-3 * self._pitch_um
        # A shift in the turned view is one of the live view, turned.
        return Placement(
            right_mm=float(cosine * best.right - sine * best.down) * mm,
            down_mm=float(sine * best.right + cosine * best.down) * mm,
            clockwise_deg=float(np.degrees(best.turn)),
            shift_sigma_mm=_SIGMA_PX * mm,
            turn_sigma_deg=_SIGMA_DEG,
            overlap=best.overlap,
            peak_to_noise=best.rank,
        )

    def _verified(self, slopes: Complex) -> list[_Place]:
        """Return the best places over all turns, judged over their true overlap, best first."""
        peaks: list[_Place] = []
        for turn in np.radians(TURNS_DEG):
            turned, _ = _turned(slopes, float(turn))
            score = np.fft.ifft2(self._spectrum * np.fft.fft2(turned, self._size)).real * self._inverse_noise
            for _ in range(2):
                down, right = (int(at) for at in np.unravel_index(int(np.argmax(score)), score.shape))
                value = float(score[down, right])
                peaks.append(_Place(_signed(right, self._size[1]), _signed(down, self._size[0]), float(turn), value))
                rows, columns = (
                    np.arange(at - _NEAR, at + _NEAR + 1) % size
                    for at, size in zip((down, right), self._size, strict=True)
                )
                score[np.ix_(rows, columns)] = 0.0
        peaks.sort(key=lambda one: -one.rank)
        distinct: list[_Place] = []
        for peak in peaks:
            if all(_apart(peak, one) for one in distinct):
                distinct.append(peak)
            if len(distinct) == VERIFIED:
                break
        return sorted((self._judged(one, *_turned(slopes, one.turn)) for one in distinct), key=lambda one: -one.rank)

    def _judged(self, place: _Place, turned: Complex, inside: Float32Array) -> _Place:
        """Return a place with whole-pixel shift and its rank, agreement and overlap over what both see there."""
        right, down = round(place.right), round(place.down)
        rows, columns = self._slopes.shape
        here = slice(max(0, -down), min(rows, rows - down)), slice(max(0, -right), min(columns, columns - right))
        there = slice(max(0, down), min(rows, rows + down)), slice(max(0, right), min(columns, columns + right))
        seen = inside[there] > 0.0
        one, other = self._slopes[here] * seen, turned[there]
        product = float(np.vdot(one, other).real)
        energy = float(np.sqrt(np.vdot(one, one).real * np.vdot(other, other).real))
        # Of slopes without anything in common, the sum over n pixels has half the mean product, root n times.
        noise = float(np.sqrt(0.5 * np.vdot(np.abs(one) ** 2, np.abs(other) ** 2))) or 1.0
        return _Place(
            right,
            down,
            place.turn,
            product / noise,
            product / energy if energy > 0.0 else 0.0,
            float(np.count_nonzero(seen)) / (rows * columns),
        )

    def _refined(self, place: _Place, slopes: Complex) -> _Place:
        """Return the place by parabolas through the agreement around it, over shift and turn."""
        step = float(np.radians(_FIRST_STEP_DEG))
        for _ in range(_ROUNDS):
            tried = []
            for turn in (place.turn - step, place.turn, place.turn + step):
                turned, inside = _turned(slopes, turn)
                around = [
                    self._judged(_Place(place.right + right, place.down + down, turn, 0.0), turned, inside)
                    for down in (-1, 0, 1)
                    for right in (-1, 0, 1)
                ]
                tried.append(max(around, key=lambda one: one.agreement))
            best = max(range(3), key=lambda at: tried[at].agreement)
            if best == 1:
                offset = _vertex(tried[0].agreement, tried[1].agreement, tried[2].agreement)
                place = _with(tried[1], turn=tried[1].turn + offset * step)
                step *= 0.5
            else:
                place = tried[best]
        turned, inside = _turned(slopes, place.turn)

        def agreement(right: int, down: int) -> float:
            there = _Place(round(place.right) + right, round(place.down) + down, place.turn, 0.0)
            return self._judged(there, turned, inside).agreement

        middle = agreement(0, 0)
        return _with(
            place,
            right=round(place.right) + _vertex(agreement(-1, 0), middle, agreement(1, 0)),
            down=round(place.down) + _vertex(agreement(0, -1), middle, agreement(0, 1)),
        )


def _with(place: _Place, right: float | None = None, down: float | None = None, turn: float | None = None) -> _Place:
    return _Place(
        place.right if right is None else right,
        place.down if down is None else down,
        place.turn if turn is None else turn,
        place.rank,
        place.agreement,
        place.overlap,
    )


def _vertex(before: float, middle: float, after: float) -> float:
    """Return where a parabola through values at -1, 0, 1 is highest, within ±0.5."""
    bend = before - 2.0 * middle + after
    return float(np.clip(0.5 * (before - after) / bend, -0.5, 0.5)) if bend < 0.0 else 0.0


def _signed(at: int, size: int) -> int:
    return at - size if at > size // 2 else at


def _apart(one: _Place, other: _Place) -> bool:
    """Return whether two places are two."""
    away = float(np.hypot(one.right - other.right, one.down - other.down))
    return away > APART_PX or abs(one.turn - other.turn) > np.radians(APART_DEG)


def _turned(slopes: Complex, turn: float) -> tuple[Complex, Float32Array]:
    """Return slopes of a view turned back by `turn` about its middle, and where they are known: arrays (h, w)."""
    rows, columns = slopes.shape
    cosine, sine = float(np.cos(turn)), float(np.sin(turn))
    middle = 0.5 * (columns - 1), 0.5 * (rows - 1)
    matrix = np.array(
        [
            [cosine, -sine, middle[0] - cosine * middle[0] + sine * middle[1]],
            [sine, cosine, middle[1] - sine * middle[0] - cosine * middle[1]],
        ]
    )
    planes = np.dstack([slopes.real, slopes.imag, np.ones(slopes.shape, np.float32)])
    moved = cv2.warpAffine(planes, matrix, (columns, rows), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
    inside = np.asarray(moved[..., 2] > 0.99, np.float32)
    back = np.complex64(np.exp(-1j * turn))
    return np.asarray((moved[..., 0] + 1j * moved[..., 1]) * back * inside, np.complex64), inside


def _fitted(slopes: Complex, shape: tuple[int, int]) -> Complex:
    """Return the slopes cut or padded with 0 about their middle to a shape."""
    if slopes.shape == shape:
        return slopes
    fitted = np.zeros(shape, np.complex64)
    sides = []
    for have, want in zip(slopes.shape, shape, strict=True):
        both = min(have, want)
        sides.append((slice((have - both) // 2, (have + both) // 2), slice((want - both) // 2, (want + both) // 2)))
    fitted[sides[0][1], sides[1][1]] = slopes[sides[0][0], sides[1][0]]
    return fitted


def _slopes(height: HeightMap, pitch_um: float) -> tuple[Complex, float]:
    """p + iq without long waves, of mean square 1, clipped, 0 where invalid, and their root mean square, µm/µm."""
    scale = height.pitch_um / pitch_um
    rows, columns = (max(4, round(size * scale)) for size in height.z_um.shape)
    small = cv2.resize(height.z_um, (columns, rows), interpolation=cv2.INTER_AREA)
    q, p = np.gradient(cv2.GaussianBlur(small, (0, 0), SMOOTHED_PX) / np.float32(pitch_um))
    slopes = np.asarray(p + 1j * q, np.complex64)
    known = np.isfinite(slopes)
    slopes = np.where(known, slopes, np.complex64(0.0))
    share = cv2.GaussianBlur(known.astype(np.float32), (0, 0), LONG_WAVE_PX) + np.float32(1e-6)
    wave = [cv2.GaussianBlur(part, (0, 0), LONG_WAVE_PX) / share for part in (slopes.real, slopes.imag)]
    slopes = np.where(known, slopes - (wave[0] + 1j * wave[1]), np.complex64(0.0)).astype(np.complex64)
    size = np.abs(slopes)
    mean = float(np.sqrt(np.mean(size[known] ** 2))) if known.any() else 0.0
    return np.asarray(slopes / np.maximum(size, max(mean, 1e-12)), np.complex64), mean


SPOT_MM: Final = 0.3
SPOT_DEG: Final = 1.5
"""Within both, the instrument is on the spot: what remains, the workstation registers."""


def placed(touch: RawFrame, model: QuickLookModel, target: Target) -> Placement | Unplaced:
    """Return where a touch lies against an earlier press. Errors as for `quick_look`."""
    return target.place(quick_look(bin_bayer(touch, model.binning), model).height)


def on_the_spot(found: Placement | Unplaced) -> bool:
    """Return whether the instrument is known to stand where the earlier press was made."""
    return isinstance(found, Placement) and found.distance_mm <= SPOT_MM and abs(found.clockwise_deg) <= SPOT_DEG


def way_back(found: Placement | Unplaced) -> tuple[float, float, float] | None:
    """Return the way as mm right, mm down and degrees clockwise; None where the place is unknown."""
    return None if isinstance(found, Unplaced) else (found.right_mm, found.down_mm, found.clockwise_deg)


def sentence(found: Placement | Unplaced) -> str:
    """Return what to do, for people."""
    if isinstance(found, Unplaced):
        return f"Place unknown: {found.reason}."
    shift = f"±{2.0 * found.shift_sigma_mm:.1f} mm, ±{2.0 * found.turn_sigma_deg:.0f}°"
    if on_the_spot(found):
        return f"On the spot ({shift})."
    ways = way_words(found.right_mm, found.down_mm, 2.0 * found.shift_sigma_mm)
    steps = [f"move {ways}"] if ways else []
    if abs(found.clockwise_deg) > 2.0 * found.turn_sigma_deg:
        turn = "clockwise" if found.clockwise_deg > 0.0 else "anticlockwise"
        steps.append(f"turn {abs(found.clockwise_deg):.0f}° {turn}")
    text = ", then ".join(steps)
    return f"{text[0].upper()}{text[1:]} ({shift})."


def way_words(right_mm: float, down_mm: float, least_mm: float) -> str:
    """Return a way in words, "8.0 mm left and 2.1 mm up", without parts shorter than `least_mm`."""
    return " and ".join(
        f"{abs(length):.1f} mm {positive if length > 0.0 else negative}"
        for length, positive, negative in ((right_mm, "right", "left"), (down_mm, "down", "up"))
        if abs(length) >= least_mm
    )
