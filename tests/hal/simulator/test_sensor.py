import msgspec
import numpy as np
import pytest

from hal.board_profile import BoardProfile
from hal.frame import BAYER_ORDERS
from hal.simulator.scene import expose, mosaic_weights


def counts(profile: BoardProfile, charge_e: float, gain: float = 1.0) -> np.ndarray:
    shape = (profile.sensor.rows, profile.sensor.columns)
    return expose(np.full(shape, charge_e, np.float32), profile.sensor, gain, np.random.default_rng(3))


@pytest.mark.parametrize("charge_e", [0.0, 50.0, 1000.0, 5000.0])
@pytest.mark.parametrize("gain", [1.0, 1.5])
def test_mean_and_variance_follow_the_photon_transfer_curve(
    profile: BoardProfile, charge_e: float, gain: float
) -> None:
    sensor = profile.sensor
    dn_per_e = gain * (sensor.white_level_dn - sensor.black_level_dn) / sensor.full_well_e
    dn = counts(profile, charge_e, gain).astype(np.float64)
    assert dn.mean() == pytest.approx(sensor.black_level_dn + charge_e * dn_per_e, abs=0.3)
    quantisation = 1.0 / 12.0
    expected = (charge_e + sensor.read_noise_e**2) * dn_per_e**2 + quantisation
    assert dn.var() == pytest.approx(expected, rel=0.03)


def test_a_full_well_saturates_at_the_white_level(profile: BoardProfile) -> None:
    assert (counts(profile, 2.0 * profile.sensor.full_well_e) == profile.sensor.white_level_dn).all()
    assert (counts(profile, 0.6 * profile.sensor.full_well_e, gain=2.0) == profile.sensor.white_level_dn).all()


@pytest.mark.parametrize("order", BAYER_ORDERS)
def test_filters_stand_in_reading_order(profile: BoardProfile, order: str) -> None:
    sensor = msgspec.structs.replace(profile.sensor, bayer_order=order)
    weights = mosaic_weights(sensor, (0.1, 0.2, 0.3))
    assert weights.shape == (sensor.rows, sensor.columns)
    passed = {"R": 0.1, "G": 0.2, "B": 0.3}
    for site, letter in enumerate(order):
        np.testing.assert_allclose(weights[site // 2 :: 2, site % 2 :: 2], passed[letter], rtol=1e-6)
