"""Frames that were not made as their calibration was are told by their light."""

import numpy as np
import pytest

from device.imaging.flat_field import NormalizedImage
from device.inverse_map.model import InverseMap
from device.inverse_map.regressor import FeatureRegressor, FeatureScaler
from device.inverse_map.training_domain import TrainingDomain
from host_sync.frame_checks.colour_check import check_datum, check_frame

SHAPE = (240, 320)


def reference() -> np.ndarray:
    """Three lights that each shine from a side of their own."""
    row, column = np.mgrid[-1.0 : 1.0 : SHAPE[0] * 1j, -1.0 : 1.0 : SHAPE[1] * 1j]
    shades = [np.exp(0.6 * (column * np.cos(a) + row * np.sin(a))) for a in np.radians([90.0, 210.0, 330.0])]
    return (0.3 * np.stack(shades, axis=-1)).astype(np.float32)


def pressed() -> np.ndarray:
    """Intensity of a press: coloured shading in the middle, 1 elsewhere."""
    values = np.ones((*SHAPE, 3), np.float32)
    random = np.random.default_rng(0)
    values[80:160, 100:220] = 1.0 + 0.4 * random.uniform(-1.0, 1.0, (80, 120, 3))
    return values


def inverse() -> InverseMap:
    seen = pressed().reshape(-1, 3)
    space, domain = FeatureScaler.observed(seen), TrainingDomain.observed(seen)
    return InverseMap(SHAPE, domain, FeatureRegressor(space, 0, 0, np.zeros((1, 1, 2), np.float32)), 1.0)


def image_of(values: np.ndarray) -> NormalizedImage:
    return NormalizedImage(np.ascontiguousarray(values, np.float32), np.ones(SHAPE, bool), np.zeros(SHAPE, bool))


def test_an_honest_frame_raises_no_warning() -> None:
    assert check_frame(image_of(pressed()), reference(), inverse()) == []
    at_rest = np.zeros(SHAPE, bool)
    at_rest[:60] = True
    assert check_datum(image_of(pressed()), at_rest) == []


@pytest.mark.parametrize(
    ("rows", "columns", "name"),
    [(-1, -1, "turned by 180"), (1, -1, "mirrored left to right"), (-1, 1, "mirrored top to bottom")],
)
def test_a_turned_frame_is_found_by_the_way_its_light_lies(rows: int, columns: int, name: str) -> None:
    light = (pressed() * reference())[::rows, ::columns]
    warnings = check_frame(image_of(light / reference()), reference(), inverse())
    assert name in warnings[0]


def test_colours_that_no_ball_showed_are_counted() -> None:
    noise = np.random.default_rng(1).uniform(0.0, 4.0, (*SHAPE, 3))
    (warning,) = [d for d in check_frame(image_of(noise), reference(), inverse()) if "unlike those of the balls" in d]
    assert "at most 25%" in warning


def test_other_exposure_or_lights_show_in_untouched_skin() -> None:
    at_rest = np.zeros(SHAPE, bool)
    at_rest[:60] = True
    (warning,) = check_datum(image_of(pressed() * np.array([0.8, 1.0, 1.0])), at_rest)
    assert "20% darker in red" in warning
    assert check_datum(image_of(0.95 * pressed()), at_rest) == []


def test_where_no_skin_rests_nothing_is_said_of_it() -> None:
    assert check_datum(image_of(0.5 * pressed()), np.ones(SHAPE, bool)) == []
