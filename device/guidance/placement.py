"""Place of the instrument relative to an earlier press: shift and turn of two quick looks, or no answer.

Slopes without long waves, strongly reduced, are correlated over shift and turn with FFTs; the best places are verified
over their true overlap. An answer needs a peak far above the noise and no other place nearly as good: guidance that is
silent costs a touch, guidance that points away costs trust. The workstation registers again and decides.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np

from device.align import Complex, PlaceSearch, Pose, is_apart, relief_slopes, seen_at
from device.imaging.flat_field import bin_bayer
from device.quick_look.solver import QuickLookModel, quick_look
from device.surface import HeightMap
from hal.frame import RawFrame

COARSE_PX: Final = 96
"""Columns of the reduced slopes."""

TURNS_DEG: Final = tuple(range(-30, 31, 3))
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

VERIFIED: Final = 6
_FIRST_STEP_DEG: Final = 1.5
_ROUNDS: Final = 3
_SIGMA_PX: Final = 0.25
_SIGMA_DEG: Final = 0.4
"""Stated uncertainties: about twice the errors of simulated touches (`tests/device/guidance/test_placement.py`)."""


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
class _Judged:
    """A pose (reduced pixels) with rank, agreement and overlap."""

    pose: Pose
    rank: float
    agreement: float
    overlap: float


class Target:
    """An earlier press, prepared once: every live quick look is placed against it."""

    def __init__(self, height: HeightMap) -> None:
        self._pitch_um = height.z_um.shape[1] * height.pitch_um / COARSE_PX
        self._slopes, self._relief = self._reduced(height)
        self._search = PlaceSearch(self._slopes.shape, TURNS_DEG, MIN_OVERLAP)
        self._spectrum = self._search.first(self._slopes)

    def place(self, live: HeightMap) -> Placement | Unplaced:
        """Return the way from where `live` was taken to this press."""
        slopes, relief = self._reduced(live)
        if min(relief, self._relief) < MIN_SLOPE:
            return Unplaced("too little relief to know where this is: press a little deeper")
        places = self._search.places(self._spectrum, self._search.second(slopes), VERIFIED)
        found = sorted((self._judged(place.pose, slopes) for place in places), key=lambda one: -one.rank)
        best = self._refined(found[0], slopes)
        if best.rank < MIN_RANK or best.agreement < MIN_AGREEMENT:
            return Unplaced("not recognised: touch nearer to the earlier place")
        if any(is_apart(found[0].pose, one.pose) and one.rank > NEXT_BEST * found[0].rank for one in found[1:]):
            return Unplaced("the relief looks alike at several places: touch where it is more distinct")
        mm = 1e-3 * self._pitch_um
        return Placement(
            right_mm=best.pose.right * mm,
            down_mm=best.pose.down * mm,
            clockwise_deg=float(np.degrees(best.pose.turn)),
            shift_sigma_mm=_SIGMA_PX * mm,
            turn_sigma_deg=_SIGMA_DEG,
            overlap=best.overlap,
            peak_to_noise=best.rank,
        )

    def _reduced(self, height: HeightMap) -> tuple[Complex, float]:
        """Return the slopes of a quick look at the reduced pitch, and their root mean square, µm/µm."""
        rows, columns = (max(4, round(size * height.pitch_um / self._pitch_um)) for size in height.z_um.shape)
        small = cv2.resize(height.z_um, (columns, rows), interpolation=cv2.INTER_AREA)
        slopes, relief = relief_slopes(np.asarray(small, np.float32))
        return slopes, relief / self._pitch_um

    def _judged(self, pose: Pose, slopes: Complex) -> _Judged:
        """Return a pose with its rank, agreement and overlap over what both see there."""
        other, seen = seen_at(slopes, pose, self._slopes.shape)
        one = self._slopes * seen
        product = float(np.vdot(one, other).real)
        energy = float(np.sqrt(np.vdot(one, one).real * np.vdot(other, other).real)) or 1.0
        # Of slopes without anything in common, the sum over n pixels has half the mean product, root n times.
        noise = float(np.sqrt(0.5 * np.vdot(np.abs(one) ** 2, np.abs(other) ** 2))) or 1.0
        return _Judged(pose, product / noise, product / energy, float(seen.mean()))

    def _refined(self, place: _Judged, slopes: Complex) -> _Judged:
        """Return the place by parabolas through the agreement around it, over shift and turn."""
        step = float(np.radians(_FIRST_STEP_DEG))
        for _ in range(_ROUNDS):
            tried = [
                max(
                    (
                        self._judged(place.pose.moved_by(down, right, turn), slopes)
                        for down in (-1, 0, 1)
                        for right in (-1, 0, 1)
                    ),
                    key=lambda one: one.agreement,
                )
                for turn in (-step, 0.0, step)
            ]
            best = int(np.argmax([one.agreement for one in tried]))
            place = tried[best]
            if best == 1:
                place = replace(place, pose=place.pose.moved_by(0.0, 0.0, step * _vertex(tried)))
                step *= 0.5
        middle = self._judged(place.pose, slopes)
        up, down, left, right = (
            self._judged(place.pose.moved_by(*step_px), slopes) for step_px in ((-1, 0), (1, 0), (0, -1), (0, 1))
        )
        return replace(place, pose=place.pose.moved_by(_vertex([up, middle, down]), _vertex([left, middle, right])))


def _vertex(places: list[_Judged]) -> float:
    """Return where a parabola through the agreement at -1, 0, 1 is highest, within ±0.5."""
    before, middle, after = (place.agreement for place in places)
    bend = before - 2.0 * middle + after
    return float(np.clip(0.5 * (before - after) / bend, -0.5, 0.5)) if bend < 0.0 else 0.0


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
