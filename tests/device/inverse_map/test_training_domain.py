"""How far a colour lies from those that balls showed."""

import numpy as np
import pytest

from device.inverse_map.regressor import DARK_OFFSET, FeatureScaler, log_intensity
from device.inverse_map.training_domain import TrainingDomain


def shown() -> np.ndarray:
    """Colours on a thin curve: far fewer than the box around them holds."""
    along = np.linspace(0.0, 2.0 * np.pi, 3000)
    return np.stack([1.0 + 0.5 * np.cos(along + turn) for turn in (0.0, 2.1, 4.2)], axis=-1).astype(np.float32)


def test_what_was_shown_has_no_excess() -> None:
    domain = TrainingDomain.observed(shown())
    assert domain.excess(shown()).max() == 0.0
    assert domain.excess(np.ones((1, 3), np.float32))[0] == 0.0


def test_a_colour_inside_the_range_of_every_channel_may_be_strange() -> None:
    """Grey and dark: every channel has been as dark, never all at once."""
    domain = TrainingDomain.observed(shown())
    assert domain.excess(np.full((1, 3), 0.6, np.float32))[0] > 0.5


def test_excess_grows_on_beyond_the_table() -> None:
    domain = TrainingDomain.observed(shown())
    near, far = domain.excess(np.array([[5.0, 5.0, 5.0], [50.0, 50.0, 50.0]], np.float32))
    assert 1.0 < near < far


def test_excess_is_in_standard_deviations() -> None:
    """Balls that changed the red alone; a colour whose blue is three standard deviations off."""
    colours = np.ones((4000, 3), np.float32)
    colours[:, 0] = np.linspace(0.5, 1.5, 4000)
    domain = TrainingDomain.observed(colours)
    spread = float(log_intensity(colours).std(axis=0).mean())
    blue = np.exp(np.log(1.0 + DARK_OFFSET) + 3.0 * spread) - DARK_OFFSET
    assert domain.excess(np.array([[1.0, 1.0, blue]], np.float32))[0] == pytest.approx(3.0, abs=0.15)


def test_a_space_survives_as_arrays_and_knows_its_range() -> None:
    space = FeatureScaler.observed(shown())
    again = FeatureScaler.from_arrays(space.arrays())
    np.testing.assert_array_equal(again.variables(shown())[0], space.variables(shown())[0])
    low, high = space.intensity_range()
    np.testing.assert_allclose(low, 0.5, atol=0.01)
    np.testing.assert_allclose(high, 1.5, atol=0.01)


def test_a_domain_survives_as_arrays() -> None:
    domain = TrainingDomain.observed(shown())
    again = TrainingDomain.from_arrays(domain.arrays())
    colours = np.random.default_rng(0).uniform(0.0, 3.0, (500, 3)).astype(np.float32)
    np.testing.assert_array_equal(again.excess(colours), domain.excess(colours))
