"""Balls' own centres along the trend that centres of symmetry show."""

from dataclasses import replace

import numpy as np
import pytest

from device.balls.sphere import Ball
from host_sync.calibration.centre_trend import centres_along_trend

SHAPE = (540, 720)
MIDDLE = (359.5, 269.5)
PLACES = tuple((100.0 + 173.0 * k, 90.0 + 180.0 * j) for j in range(3) for k in range(4))
TRUE = tuple((Ball(x, y, 55.0, 100.0),) for x, y in PLACES)

Presses = tuple[tuple[Ball, ...], ...]


def outwards(balls: Presses, share: float, scatter_px: float, seed: int) -> Presses:
    """Every ball farther from the middle of the field by a share of its distance, and scattered."""
    by = np.random.default_rng(seed).normal(0.0, scatter_px, (len(balls), 2))
    return tuple(
        (
            replace(
                ball,
                column=ball.column + share * (ball.column - MIDDLE[0]) + float(x),
                row=ball.row + share * (ball.row - MIDDLE[1]) + float(y),
            ),
        )
        for (ball,), (x, y) in zip(balls, by, strict=True)
    )


def rms_px(balls: Presses) -> float:
    off = [(ball.column - true.column, ball.row - true.row) for (ball,), (true,) in zip(balls, TRUE, strict=True)]
    return float(np.sqrt(np.square(off).mean()))


@pytest.mark.parametrize("seed", range(5))
def test_a_common_bias_goes_and_the_scatter_of_symmetry_does_not_come(seed: int) -> None:
    own, symmetric = outwards(TRUE, -0.012, 0.2, seed), outwards(TRUE, 0.0, 0.8, 100 + seed)
    along = centres_along_trend(own, symmetric, SHAPE)
    assert along is not None
    assert rms_px(own) > 1.8
    assert rms_px(along) < 0.6
    assert [ball.contact_radius_px for (ball,) in along] == [55.0] * len(TRUE)


def test_one_centre_of_symmetry_far_off_does_not_count() -> None:
    own, symmetric = outwards(TRUE, -0.012, 0.2, 7), list(outwards(TRUE, 0.0, 0.5, 8))
    symmetric[0] = (replace(symmetric[0][0], column=symmetric[0][0].column - 15.0),)
    along = centres_along_trend(own, tuple(symmetric), SHAPE)
    assert along is not None
    assert rms_px(along) < 0.6


@pytest.mark.parametrize(
    ("share", "scatter_px"),
    [(0.012, 2.5), (0.0, 0.3), (-0.02, 0.3)],
    ids=["scattered as where shadows spoil symmetry", "no trend", "towards the middle, which near lights do not do"],
)
def test_no_trend_leaves_own_centres(share: float, scatter_px: float) -> None:
    assert centres_along_trend(TRUE, outwards(TRUE, share, scatter_px, 3), SHAPE) is None
