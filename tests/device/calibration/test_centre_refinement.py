"""Centres follow a map that reads balls right, and stay where a map makes held-out balls worse round by round."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import cast

import numpy as np
import pytest

from device.balls.sphere import Ball, BallSamples, Viewpoint, sphere_slopes
from device.calibration.candidates import RegressorFit
from device.calibration.centre_refinement import FEW_BALLS, SHIFT_TAKEN, _recentred, refine, true_slopes
from device.surface import Float64Array, stereographic_from_slope

VIEW = Viewpoint(250.0, 200.0, 900.0)
TRUE = tuple(Ball(100.0 * (1 + i % 4), 100.0 * (1 + i // 4), 30.0, 60.0) for i in range(12))


@dataclass
class Ridge:
    """Reads slopes of balls at centres that its map believes in; every time it is asked they lie farther off."""

    samples: BallSamples
    drift_px: float
    asked: list[None] = field(default_factory=list)

    def held_out(self, penalties: Sequence[float], *_: object) -> list[Float64Array]:
        off = self.drift_px * 2.0 ** len(self.asked) * np.where(np.arange(len(TRUE)) % 2, 1.0, -1.0)
        self.asked.append(None)
        believed = [Ball(b.column + d, b.row, 30.0, 60.0) for b, d in zip(TRUE, off, strict=True)]
        return [np.asarray(stereographic_from_slope(*true_slopes(self.samples, believed).T)) for _ in penalties]


@dataclass
class Learner:
    ridge: Ridge | MissingRidge
    penalty: float = 1.0


def samples(balls: Sequence[Ball] = TRUE) -> BallSamples:
    row, column, ball = [], [], []
    for number, one in enumerate(balls):
        down, across = np.mgrid[-20:21:4, -20:21:4]
        row.append(one.row + down.ravel())
        column.append(one.column + across.ravel())
        ball.append(np.full(down.size, number))
    rows, columns = (np.concatenate(part).astype(np.float32) for part in (row, column))
    nothing = np.zeros(len(rows), np.float32)
    return BallSamples(np.ones((len(rows), 3), np.float32), nothing, nothing, columns, rows, np.concatenate(ball))


def refined_columns(drift_px: float, off_px: Float64Array) -> Float64Array:
    seen = samples()
    start = [Ball(b.column + d, b.row, 30.0, 60.0) for b, d in zip(TRUE, off_px, strict=True)]
    learners = [(cast(RegressorFit, Learner(Ridge(seen, drift_px))), 1.0)]
    return np.array([ball.column for ball in refine(seen, start, learners).balls])


def test_centres_go_where_the_map_puts_them() -> None:
    off_px = np.where(np.arange(len(TRUE)) % 3, 1.0, -1.0)
    found = refined_columns(0.0, off_px)
    left = found - np.array([ball.column for ball in TRUE])
    assert left - np.median(left) == pytest.approx(np.zeros(len(TRUE)), abs=0.05)


def test_centres_that_run_away_are_taken_back() -> None:
    start = np.array([ball.column for ball in TRUE])
    assert refined_columns(0.5, np.zeros(len(TRUE))) == pytest.approx(start, abs=0.5)


@dataclass
class MissingRidge:
    """Reads slopes too steep, those of the missed balls twice as much as others."""

    samples: BallSamples
    balls: Sequence[Ball]
    missed: tuple[int, ...]

    def held_out(self, penalties: Sequence[float], *_: object) -> list[Float64Array]:
        too_steep = 1.0 + np.where(np.isin(self.samples.ball, self.missed), 0.2, 0.1)
        tilt = true_slopes(self.samples, self.balls) * too_steep[:, None]
        return [np.asarray(stereographic_from_slope(*tilt.T)) for _ in penalties]


@pytest.mark.parametrize("one_a_press", [True, False])
def test_a_ball_in_a_corner_may_be_read_worse_when_it_was_pressed_alone(one_a_press: bool) -> None:
    balls = [Ball(60.0 * (1 + i % 6), 60.0 * (1 + i // 6), 20.0, 60.0) for i in range(30)]
    assert len(balls) >= FEW_BALLS
    seen = samples(balls)
    learners = [(cast(RegressorFit, Learner(MissingRidge(seen, balls, (0, 14)))), 1.0)]
    kept = refine(seen, balls, learners, np.full(len(balls), one_a_press)).kept
    assert kept.tolist() == [number != 14 and (number != 0 or one_a_press) for number in range(len(balls))]


def seen_nearby() -> tuple[BallSamples, tuple[Ball, ...]]:
    """Samples of balls that stand 30 px high under a camera at 900 px."""
    balls = tuple(Ball(b.column, b.row, 30.0, 60.0, VIEW, 30.0) for b in TRUE)
    across, down = (part.ravel() for part in np.meshgrid(np.arange(-24.0, 25.0, 6.0), np.arange(-24.0, 25.0, 6.0)))
    column, row = (
        np.concatenate([at + off for at in places]).astype(np.float32)
        for places, off in (([b.column for b in balls], across), ([b.row for b in balls], down))
    )
    number = np.repeat(np.arange(len(balls)), len(across))
    slopes = [sphere_slopes(b, column[number == n], row[number == n]) for n, b in enumerate(balls)]
    p, q = (np.concatenate([pair[axis] for pair in slopes]) for axis in (0, 1))
    return BallSamples(np.ones((len(p), 3), np.float32), p, q, column, row, number), balls


def test_maps_are_taught_what_a_camera_nearby_sees() -> None:
    samples, balls = seen_nearby()
    np.testing.assert_allclose(true_slopes(samples, balls), np.stack([samples.p, samples.q], -1), atol=1e-5)
    assert np.abs(true_slopes(samples, balls) - true_slopes(samples, TRUE)).max() > 0.01


def test_centres_are_found_as_a_camera_nearby_sees_them() -> None:
    samples, balls = seen_nearby()
    off = 2.0 * np.where(np.arange(len(balls)) % 2, 1.0, -1.0)
    moved = tuple(replace(b, column=b.column + d) for b, d in zip(balls, off, strict=True))
    right = np.stack([samples.p, samples.q], -1).astype(np.float64)
    found = _recentred(samples, moved, right, np.ones(len(balls), bool))
    left = np.array([b.column - t.column for b, t in zip(found, balls, strict=True)])
    np.testing.assert_allclose(left, (1.0 - SHIFT_TAKEN) * off, atol=0.1)
