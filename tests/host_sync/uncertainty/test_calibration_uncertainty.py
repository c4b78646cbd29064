"""What replicas of a map disagree on is the doubt of slopes: none where they agree."""

from dataclasses import replace

import numpy as np
import pytest

from device.imaging.flat_field import NormalizedImage
from device.inverse_map.model import InverseMap
from device.inverse_map.regressor import FeatureRegressor, FeatureScaler
from device.inverse_map.training_domain import TrainingDomain
from host_sync.uncertainty.calibration_uncertainty import calibration_uncertainty

SHAPE, SIZE = (60, 80), (40, 30)


def tilting(slope: float) -> InverseMap:
    """A map that reads `slope` across times the column's position, -1 to 1, whatever the colour."""
    low, high = np.log([0.05, 5.0]).astype(np.float32)
    space = FeatureScaler(np.zeros(3, np.float32), np.ones(3, np.float32), np.full(3, low), np.full(3, high))
    coefficients = np.zeros((1, 3, 2), np.float32)
    coefficients[0, 2, 0] = slope
    return InverseMap(
        SHAPE, TrainingDomain.observed(np.ones((4, 3), np.float32)), FeatureRegressor(space, 0, 1, coefficients), 1.0
    )


def image() -> NormalizedImage:
    return NormalizedImage(np.ones((*SHAPE, 3), np.float32), np.ones(SHAPE, bool), np.zeros(SHAPE, bool))


def test_replicas_that_agree_leave_no_doubt() -> None:
    doubt = calibration_uncertainty(image(), [tilting(0.02)] * 5, SIZE)
    assert np.abs(doubt.p).max() < 1e-6
    assert doubt.sigma(SHAPE).max() < 1e-6


def test_doubt_is_the_jackknifes_and_stands_where_replicas_part() -> None:
    slopes = np.array([0.010, 0.012, 0.008, 0.011, 0.009])
    doubt = calibration_uncertainty(image(), [tilting(slope) for slope in slopes], SIZE)
    jackknife = np.sqrt(4.0 / 5.0 * ((slopes - slopes.mean()) ** 2).sum())
    sigma = doubt.sigma(SHAPE)
    assert sigma[30, 79] == pytest.approx(jackknife / np.sqrt(2.0), rel=0.03)  # of two components one alone is unsure
    assert sigma[30, 40] < 0.03 * sigma[30, 79]


def test_deviations_keep_their_shape_over_the_field() -> None:
    doubt = calibration_uncertainty(image(), [tilting(slope) for slope in (0.01, 0.02, 0.03)], SIZE)
    correlation = np.corrcoef(doubt.p[:, 15, 0], doubt.p[:, 15, -1])[0, 1]
    assert correlation == pytest.approx(-1.0, abs=1e-3)


def test_two_doubts_are_mixed_place_by_place() -> None:
    one, other = (calibration_uncertainty(image(), [tilting(slope), tilting(-slope)], SIZE) for slope in (0.01, 0.04))
    right = np.zeros((30, 40), np.float32)
    right[:, 20:] = 1.0
    sigma = one.mixed_with(other, right).sigma((30, 40))
    np.testing.assert_allclose(sigma[:, :20], one.sigma((30, 40))[:, :20], atol=1e-7)
    np.testing.assert_allclose(sigma[:, 20:], other.sigma((30, 40))[:, 20:], atol=1e-7)


def test_without_replicas_there_is_no_doubt_to_draw() -> None:
    doubt = calibration_uncertainty(image(), [], SIZE)
    assert doubt.p.shape == (0, 30, 40)
    assert doubt.sigma(SHAPE).max() == 0.0


def test_a_replica_of_a_full_size_map_is_read_on_the_reduced_field() -> None:
    doubt = calibration_uncertainty(image(), [replace(tilting(0.0), shape=(600, 800)), tilting(0.1)], SIZE)
    assert doubt.p.shape == (2, 30, 40)
