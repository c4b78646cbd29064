"""Centres follow a map that reads balls right, and stay where a map makes held-out balls worse round by round."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import cast

import numpy as np
import pytest

from device.balls.sphere import Ball, BallSamples
from device.calibration.candidates import RegressorFit
from device.calibration.centre_refinement import FEW_BALLS, refine, true_slopes
from device.surface.fields import Float64Array
from device.surface.stereographic import stereographic_from_slope

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
