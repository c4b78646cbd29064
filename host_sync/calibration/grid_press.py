"""Grid presses: the lattice helps to find the balls, and the balls measure the pixel pitch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from device.balls.detector import MIN_CONTACT, BallSearch, RejectedBall, find_balls
from device.balls.sphere import Ball
from device.imaging.flat_field import NormalizedImage
from device.surface.fields import Float64Array
from host_sync.calibration.balls import PressFrame, UsedPress, with_found
from host_sync.calibration.homography import project
from host_sync.calibration.lattice import GROWTH, ON_LATTICE, BallLattice, find_lattice
from host_sync.calibration.pixel_pitch import PitchReading, PixelPitch, join_readings, read_pitch

DEEPEST_SHARE = 0.98
"""A given contact is held to this share of the ball's radius when the radius in pixels is corrected."""


@dataclass(frozen=True, slots=True, eq=False)
class GridDetection:
    """Balls of a grid press less those off the lattice, and the lattice, None when they form none."""

    search: BallSearch
    lattice: BallLattice | None


def detect_grid(image: NormalizedImage, seen: BallSearch, radius_px: float) -> GridDetection:
    """Return the balls of a grid press; where the lattice expects one that was missed, it is looked for once more."""
    lattice = find_lattice(_centres(seen))
    if lattice is None:
        return GridDetection(seen, None)
    expected = _unseen(lattice, seen, image.shape, radius_px)
    if expected:
        again = find_balls(image, radius_px, expected)
        relaid = find_lattice(_centres(again))
        if relaid is not None and relaid.on.sum() >= lattice.on.sum():
            # A look at a place where nothing is finds nothing good; only what was rejected unasked is worth a word.
            seen, lattice = BallSearch(again.found, seen.rejected), relaid
    return _on_lattice(seen, lattice)


def measure_pitch(
    presses: Sequence[PressFrame], located: Sequence[UsedPress], stated_um: float
) -> tuple[list[UsedPress], PixelPitch | None]:
    """Return the presses, their balls held to the lattice and to the measured scale, and the pixel pitch.

    The pitch is None where no press shows a grid of known spacing.

    Raises
    ------
    CalibrationError
        The stated pitch is grossly wrong.
    """
    found: list[UsedPress] = []
    readings: list[PitchReading] = []
    for press, used in zip(presses, located, strict=True):
        if press.grid is None or used.seen is None:
            found.append(used)
            continue
        grid = detect_grid(used.intensity, used.seen, press.radius_px)
        own = replace(used, seen=grid.search)
        found.append(own if press.balls is not None else with_found(own, grid.search, press.radius_px))
        if grid.lattice is not None:
            balls, shape = grid.search.found, used.intensity.shape
            readings.append(read_pitch(press.label, grid.lattice, balls, press.grid, shape))
    if not readings:
        return found, None
    pitch = join_readings(stated_um, readings)
    return [_rescaled(used, stated_um / pitch.pitch_um) for used in found], pitch


def _on_lattice(seen: BallSearch, lattice: BallLattice) -> GridDetection:
    """Return the search with the balls off the lattice among the rejected, the lattice for the others alone.

    What the finder itself rejected off the lattice is no ball at all and is forgotten.
    """
    places = lattice.pixels(lattice.index)
    off = []
    for number in np.flatnonzero(~lattice.on):
        ball = seen.found[number]
        away_px = float(np.hypot(ball.column - places[number, 0], ball.row - places[number, 1]))
        share = away_px / lattice.step_px(lattice.index[number])
        off.append(RejectedBall(ball.column, ball.row, f"off the grid by {away_px:.1f} px ({share:.0%} of its step)"))
    on = lattice.on
    balls = tuple(ball for ball, kept in zip(seen.found, on, strict=True) if kept)
    kept_lattice = BallLattice(lattice.index[on], on[on], lattice.to_pixels)
    rejected = tuple(ball for ball in seen.rejected if _stray(lattice, ball) < GROWTH)
    return GridDetection(BallSearch(balls, rejected + tuple(off)), kept_lattice)


def _stray(lattice: BallLattice, ball: RejectedBall) -> float:
    """Return the distance of a rejected ball from the nearest place of the lattice, in steps."""
    place = project(np.asarray(np.linalg.inv(lattice.to_pixels), np.float64), np.array([[ball.column, ball.row]]))
    return float(np.hypot(*(place - np.round(place))[0]))


def _unseen(
    lattice: BallLattice, seen: BallSearch, shape: tuple[int, int], radius_px: float
) -> list[tuple[float, float]]:
    """Return places (column, row) of the lattice that the frame could show and where nothing, good or rejected, is
    seen."""
    missing = lattice.missing()
    if not len(missing):
        return []
    places = lattice.pixels(missing)
    margin = np.minimum(places, np.array([shape[1] - 1.0, shape[0] - 1.0]) - places).min(axis=1)
    known = np.array([(b.column, b.row) for b in seen.found] + [(b.column, b.row) for b in seen.rejected])
    apart = np.hypot(*(places[:, None] - known).transpose(2, 0, 1)).min(axis=1)
    wanted = (margin > MIN_CONTACT * radius_px) & (apart > ON_LATTICE * lattice.step_px(np.zeros(2)))
    return [(float(column), float(row)) for column, row in places[wanted]]


def _centres(search: BallSearch) -> Float64Array:
    return np.array([(ball.column, ball.row) for ball in search.found], np.float64).reshape(-1, 2)


def _rescaled(press: UsedPress, factor: float) -> UsedPress:
    """Return the press with balls whose radius in pixels is `factor` times as large."""
    seen = press.seen and replace(press.seen, found=tuple(_with_radius(ball, factor) for ball in press.seen.found))
    return replace(press, balls=tuple(_with_radius(ball, factor) for ball in press.balls), seen=seen)


def _with_radius(ball: Ball, factor: float) -> Ball:
    radius_px = factor * ball.radius_px
    return replace(ball, radius_px=radius_px, contact_radius_px=min(ball.contact_radius_px, DEEPEST_SHARE * radius_px))
