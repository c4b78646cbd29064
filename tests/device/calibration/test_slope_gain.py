"""The gain of slopes that are read too steep by a known factor, of balls off centre and with noise."""

import numpy as np
import pytest

from device.calibration.cross_validation import HeldOutReadings, gains_of_balls, slope_gains


def readings(gain: float, *, noise: float = 0.02, centre: float = 0.0, balls: int = 12) -> HeldOutReadings:
    """Every ball shows slopes to 28 degrees in all directions; its truth is off by `centre` some way of its own."""
    random = np.random.default_rng(0)
    parts = []
    for _ in range(balls):
        radius, angle = np.sqrt(random.uniform(0.0, 1.0, 4000)) * 0.53, random.uniform(0.0, 2.0 * np.pi, 4000)
        parts.append(np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1))
    true = np.concatenate(parts)
    ball = np.repeat(np.arange(balls), 4000)
    off = centre * random.standard_normal((balls, 2))[ball]
    read = gain * true + noise * random.standard_normal(true.shape)
    return HeldOutReadings(read, true + off, np.zeros_like(true), ball, np.full(balls, 100.0))


@pytest.mark.parametrize("gain", [0.93, 1.0, 1.05])
def test_a_common_factor_is_found_in_every_band_within_its_uncertainty(gain: float) -> None:
    bands = slope_gains(readings(gain))
    assert [(band.from_deg, band.to_deg) for band in bands] == [(0.0, 3.0), (3.0, 8.0), (8.0, 15.0), (15.0, 30.0)]
    for band in bands:
        assert band.sigma is not None
        assert abs(band.gain - gain) < 3.0 * band.sigma + 1e-3
        assert band.sigma < 0.03


def test_centres_that_are_off_do_not_pass_for_a_gain() -> None:
    right, off = (slope_gains(readings(1.0, noise=0.005, centre=centre)) for centre in (0.0, 0.006))
    assert [band.gain for band in off] == pytest.approx([band.gain for band in right], abs=0.01)


def test_one_ball_alone_has_no_uncertainty() -> None:
    assert all(band.sigma is None for band in slope_gains(readings(1.0, balls=1)))


def test_every_ball_has_a_gain_of_its_own_whatever_its_centre() -> None:
    truth = np.random.default_rng(4).uniform(-0.2, 0.2, (400, 2))
    ball = np.repeat([0, 1, 2], [190, 190, 20])
    read = np.array([0.98, 1.03, 1.0])[ball][:, None] * truth + 0.05
    assert gains_of_balls(read, truth, ball) == pytest.approx([0.98, 1.03])
