"""Balls' own centres, moved by what rotational symmetry shows of a bias that grows from the middle of the field.

Level skin at an apex stands nearer to near lights and looks tilted towards the outside, so that a centre that is sought
where skin looks level lies too near to the middle of the field, by a share of its distance. Centres of symmetry do not
know of it, but one by one they may scatter more. The share by which they lie farther out is common to all balls:
fitted over all of them it is known better than any one centre.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from device.balls.sphere import Ball
from device.surface.fields import Float64Array

MAX_SCATTER: Final = 0.012
"""Scatter of the differences around their trend, as a share of the ball's radius, up to which the trend is believed.

0.007 on a rendered bench of high strips. 0.018 to 0.022 on the twin, where the border and shadows spoil symmetry.
"""

SIGNIFICANT: Final = 3.0
"""Standard uncertainties by which the share must exceed zero."""

ROUNDS: Final = 10
OUTLYING: Final = 3.0
"""Differences farther from the trend than so many standard deviations count less than half."""

NORMAL_MEDIAN: Final = 1.483
"""Standard deviation of a normal variable over the median of its magnitude."""


def centres_along_trend(
    own: Sequence[Sequence[Ball]], symmetric: Sequence[Sequence[Ball]], shape: tuple[int, int]
) -> tuple[tuple[Ball, ...], ...] | None:
    """The balls of every press moved along the trend from their own centres to those of symmetry.

    own, symmetric : the same balls, press by press
    shape : (H, W) of the field

    None where the differences show no such trend.
    """
    place, there = (np.array([(b.column, b.row) for of_press in balls for b in of_press]) for balls in (own, symmetric))
    middle = np.array([0.5 * (shape[1] - 1), 0.5 * (shape[0] - 1)])
    radius_px = float(np.median([ball.radius_px for of_press in own for ball in of_press]))
    design = np.concatenate([np.eye(2)[None].repeat(len(place), axis=0), (place - middle)[:, :, None]], axis=2)
    trend, share_sigma, scatter_px = _robust_fit(design, there - place)
    if trend[2] < SIGNIFICANT * share_sigma or scatter_px > MAX_SCATTER * radius_px:
        return None
    moved = iter((place + design @ trend).tolist())

    def at(ball: Ball) -> Ball:
        column, row = next(moved)
        return replace(ball, column=column, row=row)

    return tuple(tuple(at(ball) for ball in of_press) for of_press in own)


def _robust_fit(design: Float64Array, wanted: Float64Array) -> tuple[Float64Array, float, float]:
    """Coefficients of (N, 2, 3) that explain (N, 2), the last one's standard uncertainty, and the scatter left."""
    weight = np.ones(len(wanted))
    for _ in range(ROUNDS):
        gram = np.einsum("n,nik,nil->kl", weight, design, design)
        found = np.linalg.solve(gram, np.einsum("n,nik,ni->k", weight, design, wanted))
        left = wanted - design @ found
        scatter = NORMAL_MEDIAN * float(np.median(np.abs(left)))
        weight = 1.0 / (1.0 + (left**2).sum(axis=1) / (OUTLYING * max(scatter, 1e-6)) ** 2)
    return found, scatter * float(np.sqrt(np.linalg.inv(gram)[2, 2])), scatter
