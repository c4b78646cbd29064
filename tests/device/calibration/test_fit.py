"""A fit of nearly the same samples as another takes its forms and chooses penalties and shares anew."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from device.balls.sphere import Ball, BallSamples, gather_samples, sphere_slopes
from device.calibration.candidates import RegressorFit
from device.calibration.fit import BegunFit, _shared, begin_fit
from device.imaging.flat_field import NormalizedImage
from device.inverse_map.near_light import IlluminationMap

SHAPE = (160, 220)
BALLS = tuple(Ball(column, row, 24.0, 40.0) for row in (40.0, 80.0, 120.0) for column in (40.0, 110.0, 180.0))


def samples(noise: float) -> BallSamples:
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float32)
    rng, presses = np.random.default_rng(0), []
    for ball in BALLS:
        p, q = sphere_slopes(ball, column, row)
        inside = (column - ball.column) ** 2 + (row - ball.row) ** 2 <= ball.contact_radius_px**2
        values = np.ones((*SHAPE, 3))
        for channel, angle in enumerate(np.radians([90.0, 210.0, 330.0])):
            towards = 0.6 * (1.0 + 0.2 * (column - 110.0) / 110.0)
            shade = (1.0 - towards * (p * np.cos(angle) + q * np.sin(angle))) / np.sqrt(1.0 + p**2 + q**2)
            values[..., channel] = np.where(inside, np.maximum(shade, 0.02), 1.0)
        seen = (values + noise * rng.standard_normal(values.shape)).astype(np.float32)
        presses.append((NormalizedImage(seen, np.ones(SHAPE, bool), np.zeros(SHAPE, bool)), [ball]))
    return gather_samples(presses)


def begun(noise: float, like: BegunFit | None = None) -> BegunFit:
    even = IlluminationMap(np.ones((2, 2, 3), np.float32))
    return begin_fit(samples(noise), BALLS, SHAPE, max_samples=6_000, light=even, thorough=True, like=like)


def forms(fit: BegunFit) -> list[tuple[object, ...]]:
    assert fit.learned is not None
    plain, learners = fit.learned
    every = [plain, *(learner for learner, _ in learners)]
    return [(one.form.colour_degree, one.form.position_degree, type(one.reading), one.flat) for one in every]


def test_the_same_samples_give_the_same_map() -> None:
    first = begun(0.01)
    again = begun(0.01, first)
    assert forms(again) == forms(first)
    for name, array in first.fit.map.arrays().items():
        np.testing.assert_array_equal(again.fit.map.arrays()[name], array)
    assert again.finished().held_out_deg == first.fit.held_out_deg


def test_noisier_samples_keep_the_forms_and_dearer_terms() -> None:
    first = begun(0.0)
    again = begun(0.1, first)
    assert set(forms(again)) <= set(forms(first))
    assert first.learned is not None
    assert again.learned is not None
    assert again.learned[0].penalty > first.learned[0].penalty
    assert again.fit.held_out_deg == pytest.approx(begun(0.1).fit.held_out_deg, rel=0.05)


def test_a_fit_of_a_lone_ball_has_no_forms_to_take() -> None:
    every = samples(0.01)
    lone = every.select(np.flatnonzero(every.ball == 0))
    assert begin_fit(lone, BALLS[:1], SHAPE).learned is None


def test_a_curve_that_is_far_worse_than_another_keeps_a_share_that_can_be_divided_by() -> None:
    own, other = (cast(RegressorFit, SimpleNamespace(error_as_seen=error)) for error in (1.0, 1e-3))
    (_, first), (_, second) = _shared(own, [other])
    assert np.float32(first) > 0.0
    assert np.isfinite(np.float32(1.0) / np.float32(first))
    assert second > 0.99
