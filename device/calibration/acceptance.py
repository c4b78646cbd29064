"""Limits that a calibration must keep on device and workstation alike, and its checks by them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from device.balls.detector import RejectedBall
from device.balls.sphere import BallSamples
from device.calibration.fit import InverseFit
from device.errors import CalibrationError
from device.surface import MaskArray

MIN_BALLS: Final = 4
"""With fewer balls no error can be held out that means anything."""

WORST_HELD_OUT_DEG: Final = 8.0
"""A calibration whose held-out balls are worse is refused."""

MAX_RADIUS_SPREAD: Final = 0.08
"""Standard deviation, over balls, of the radius that shading gives over the one stated; more is a disagreement.
A set of few balls is refused from a larger one on (`radii.check_radii`)."""

MAX_CLIPPED: Final = 0.3
"""A ball with a larger share of its contact saturated is not used for training."""

REFERENCE_CLIPPED: Final = 0.1
"""A reference with a larger share saturated cannot be divided by."""

CLEAR_DISAGREEMENT: Final = 0.12
"""Less than `flat_field.MAX_DISAGREEMENT` is two sets of lights too where every frame has another that is twice as
near."""

MAX_PITCH_ERROR: Final = 0.05
"""A stated pixel pitch that a ball grid contradicts by more is refused; less is reported, the measured one used."""

PITCH_COVERAGE: Final = 2.0
"""A stated pitch this many standard uncertainties off is contradicted."""

PASSED_HELD_OUT_DEG: Final = 5.0
PASSED_STEEPEST_DEG: Final = 25.0
PASSED_SECTORS: Final = 5
PASSED_REJECTED_FRACTION: Final = 0.35
"""Report: a calibration passes up to this held-out error, from this covered slope and number of sectors (of nine) on,
and up to this share of rejected balls."""

PASSED_RESTING: Final = 0.8
"""Least fraction of the reference, given as a scan, that reads as skin at rest."""


class Check(msgspec.Struct, frozen=True):
    """One number and the limit that it must keep."""

    name: str
    value: float
    limit: float
    kind: Literal["at most", "at least"]

    @property
    def passed(self) -> bool:
        """True if the limit is kept."""
        return self.value <= self.limit if self.kind == "at most" else self.value >= self.limit

    @property
    def words(self) -> str:
        """Value and limit, for example "0.147 (at most 0.07)"; a share in per cent."""
        number = ".0%" if self.name.startswith("share") else ".3g"
        return f"{self.value:{number}} ({self.kind} {self.limit:{number}})"


def check_fit(inverse: InverseFit) -> None:
    """Refuse a fit whose held-out balls are wrong.

    Raises
    ------
    CalibrationError
        Names the error.
    """
    if inverse.held_out_deg is not None and inverse.held_out_deg > WORST_HELD_OUT_DEG:
        raise CalibrationError(
            f"the balls contradict each other (held-out error {inverse.held_out_deg:.1f} degrees, at most "
            f"{WORST_HELD_OUT_DEG:g}): check the balls' radii and places, wipe ball and gel, and press again"
        )


def fit_checks(balls: int, rejected: int, held_out_deg: float | None, coverage: Coverage) -> tuple[Check, ...]:
    """Return what is judged of every calibration.

    balls, rejected : number of training balls, and of rejected ones
    held_out_deg : error on held-out balls; None when it is unknown, and then not judged
    """
    covered = sum(coverage.sectors.values())
    share = rejected / (balls + rejected) if balls + rejected else 1.0
    found = [
        Check("balls used", float(balls), float(MIN_BALLS), "at least"),
        Check("share of balls rejected", share, PASSED_REJECTED_FRACTION, "at most"),
        Check("steepest slope covered, degrees", coverage.steepest_deg, PASSED_STEEPEST_DEG, "at least"),
        Check("sectors of the frame covered, of nine", float(covered), float(PASSED_SECTORS), "at least"),
    ]
    if held_out_deg is not None:
        found.append(Check("held-out error, degrees", held_out_deg, PASSED_HELD_OUT_DEG, "at most"))
    return tuple(found)


# Parts of the frame and slopes that the balls of a calibration cover, and advice on what to press next.

RealArray = NDArray[np.floating | np.integer]

SIDES: Final = 3
_DOWN: Final = ("upper", "middle", "lower")
_ACROSS: Final = ("left", "centre", "right")
DIRECTIONS: Final = ("right", "lower right", "down", "lower left", "left", "upper left", "up", "upper right")
"""Directions in which the surface falls, clockwise as the frame is seen."""


def _sector(down: int, across: int) -> str:
    """Return a sector in words, such as "upper left corner"."""
    if down == across == 1:
        return "middle of the frame"
    if 1 in (down, across):
        return f"{_ACROSS[across]} edge" if down == 1 else f"{_DOWN[down]} edge"
    return f"{_DOWN[down]} {_ACROSS[across]} corner"


SECTORS: Final = tuple(_sector(row, column) for row in range(SIDES) for column in range(SIDES))
"""Names of the nine sectors, row by row."""

SECTOR_BALLS: Final = 0.25
"""A sector is covered by this share of an average ball's pixels."""

TILTED_DEG: Final = 10.0
DIRECTION_FRACTION: Final = 0.25
"""A direction is covered by this share of the tilted pixels that it would have were all directions alike."""


class Coverage(msgspec.Struct, frozen=True):
    """Parts of the frame and slopes that the balls cover.

    sectors : by name of the nine sectors of the frame, whether a training ball lies there
    directions : by the direction in which the surface falls, whether tilted pixels show it
    steepest_deg : slopes are covered up to here
    contradicted : sectors in which the model gets as many balls wrong as trained it
    """

    sectors: dict[str, bool]
    directions: dict[str, bool]
    steepest_deg: float
    contradicted: tuple[str, ...] = ()

    @property
    def uncovered(self) -> tuple[str, ...]:
        """Names of the sectors in which no training ball lies, or the model is contradicted."""
        return tuple(name for name, covered in self.sectors.items() if not covered or name in self.contradicted)

    def next_place(self) -> tuple[float, float] | None:
        """Return the middle of the first uncovered sector; None when all are covered.

        Column and row are fractions of the field's.
        """
        for number, covered in enumerate(self.sectors.values()):
            if not covered:
                return (number % SIDES + 0.5) / SIDES, (number // SIDES + 0.5) / SIDES
        return None

    def next_presses(self) -> tuple[str, ...]:
        """Return what to press next, one sentence each; none when all is covered."""
        sides = [name for name, covered in self.directions.items() if not covered]
        advice = [f"{name} uncovered: press a ball there" for name in self.uncovered]
        if sides:
            advice.append(
                f"slopes that fall to the {', '.join(sides)} uncovered: press balls whose whole contact is seen"
            )
        if self.steepest_deg < PASSED_STEEPEST_DEG:
            advice.append(
                f"slopes beyond {self.steepest_deg:.0f} degrees uncovered: press deeper, "
                f"to {PASSED_STEEPEST_DEG:.0f} degrees at least"
            )
        return tuple(advice)


def measure_coverage(
    samples: BallSamples, shape: tuple[int, int], steepest: float, rejected: Sequence[RejectedBall] = ()
) -> Coverage:
    """Return the coverage of a frame of `shape` (H, W) by the samples of the training balls.

    steepest : largest slope of the training balls
    rejected : other balls of the same presses
    """
    count = np.bincount(sector_indices(samples.row, samples.column, shape), minlength=SIDES**2)
    balls = count * (int(samples.ball.max()) + 1) / len(samples.p)
    places = np.array([(ball.row, ball.column) for ball in rejected if ball.error_deg is not None]).reshape(-1, 2)
    wrong = np.bincount(sector_indices(places[:, 0], places[:, 1], shape), minlength=SIDES**2)
    return Coverage(
        {name: bool(part >= SECTOR_BALLS) for name, part in zip(SECTORS, balls, strict=True)},
        _directions(samples),
        float(np.degrees(np.arctan(steepest))),
        tuple(name for name, part, other in zip(SECTORS, balls, wrong, strict=True) if 0 < part <= other),
    )


def sector_indices(row: RealArray, column: RealArray, shape: tuple[int, int]) -> NDArray[np.intp]:
    """Return the index in `SECTORS` of each place of a frame of `shape` (H, W); row and column in pixels."""
    down = np.clip(row * SIDES / shape[0], 0, SIDES - 1).astype(np.intp)
    across = np.clip(column * SIDES / shape[1], 0, SIDES - 1).astype(np.intp)
    return np.asarray(down * SIDES + across, np.intp)


def _directions(samples: BallSamples) -> dict[str, bool]:
    tilted: MaskArray = np.hypot(samples.p, samples.q) > np.tan(np.radians(TILTED_DEG))
    falls = np.arctan2(-samples.q[tilted], -samples.p[tilted])
    count = np.bincount(np.round(falls / (np.pi / 4.0)).astype(int) % 8, minlength=8)
    enough = max(DIRECTION_FRACTION * tilted.sum() / 8.0, 1.0)
    return {name: bool(pixels >= enough) for name, pixels in zip(DIRECTIONS, count, strict=True)}
