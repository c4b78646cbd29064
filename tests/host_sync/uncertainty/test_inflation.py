"""How far fitted errors are scaled up to those of held-out balls."""

from __future__ import annotations

import numpy as np
import pytest

from host_sync.uncertainty.slope_error import LONE_BALL_INFLATION, MEAN_OF_TWO, BandErrors, Inflation


def test_without_noise_the_factor_is_the_ratio_of_errors() -> None:
    assert BandErrors(0.0, 10.0, held_out_deg=1.5, fitted_deg=1.0).inflation(0.0) == pytest.approx(1.5)


def test_noise_that_both_errors_hold_is_no_share_of_what_the_map_gets_wrong() -> None:
    noise, fitted, held_out = 0.6, 0.8, 1.2
    errors = BandErrors(0.0, 10.0, float(np.hypot(held_out, noise)), float(np.hypot(fitted, noise)))
    assert errors.inflation(noise / MEAN_OF_TWO) == pytest.approx(held_out / fitted)


def test_held_out_balls_never_make_errors_smaller() -> None:
    assert BandErrors(0.0, 10.0, held_out_deg=0.9, fitted_deg=1.0).inflation(0.1) == 1.0


def test_an_error_that_is_all_noise_keeps_the_factor_finite() -> None:
    factor = BandErrors(0.0, 10.0, held_out_deg=1.1, fitted_deg=1.0).inflation(5.0)
    assert 1.1 < factor < 2.0


def test_every_band_of_steepness_has_its_own_factor_and_the_rest_that_of_all() -> None:
    inflation = Inflation(BandErrors(0.0, 90.0, 1.2, 1.0), (BandErrors(30.0, 40.0, 2.0, 1.0),))
    assert inflation.at(35.0, 0.0) == pytest.approx(2.0)
    assert inflation.at(5.0, 0.0) == inflation.throughout(0.0) == pytest.approx(1.2)


def test_a_lone_ball_has_a_factor_of_its_own() -> None:
    assert Inflation(None).at(10.0, 0.1) == Inflation(None).throughout(0.1) == LONE_BALL_INFLATION
