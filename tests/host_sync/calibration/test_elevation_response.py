"""What elevation does to colours, told by balls under lamps that stand at a known height."""

import numpy as np
import pytest
from near_lamps import LAMPS_OUT_PX, SHAPE, NearLamps, balls, press_px

from host_sync.calibration.elevation_response import (
    MIN_BALLS,
    NODES,
    ElevationResponse,
    measure_elevation_response,
)

HEIGHT_PX = 220.0


def measured(lamps: NearLamps, count: int = 12, *, seen_at: float = 1.0) -> ElevationResponse | None:
    shown = [
        (lamps.intensity(press_px(ball, apex), seen_at=seen_at, noise=0.01, seed=i), ball, apex)
        for i, (ball, apex) in enumerate(balls(count))
    ]
    return measure_elevation_response(shown, lamps.flat_field())


def root_mean_square(values: np.ndarray) -> float:
    return float(np.sqrt((values**2).mean()))


@pytest.mark.parametrize("vignetting", [0.0, 0.4])
def test_the_lamps_height_is_found_whatever_the_lens_takes_away(vignetting: float) -> None:
    found = measured(NearLamps(HEIGHT_PX, vignetting))
    assert found is not None
    assert found.is_certain
    assert found.share == pytest.approx(1.0, abs=0.15)
    assert found.nearness_per_px * HEIGHT_PX == pytest.approx(1.0, abs=0.15)
    assert 0.0 < found.nearness_sigma_per_px < 0.5 * found.nearness_per_px


def test_brightness_directions_and_slants_are_those_of_the_lamps() -> None:
    found = measured(NearLamps(HEIGHT_PX))
    assert found is not None
    side = np.linspace(-1.0, 1.0, NODES)
    x, y = np.meshgrid(0.5 * SHAPE[1] * side, 0.5 * SHAPE[0] * side)
    inner = np.s_[4:-4, 4:-4]
    for channel, angle in enumerate(np.radians([10.0, 130.0, 250.0])):
        across, down = LAMPS_OUT_PX * np.cos(angle) - x, LAMPS_OUT_PX * np.sin(angle) - y
        square = across**2 + down**2 + HEIGHT_PX**2
        brighter = 3.0 * HEIGHT_PX / square - 1.0 / HEIGHT_PX
        assert root_mean_square(found.directions[inner][..., 0, channel] + across[inner] / HEIGHT_PX) < 0.032
        assert root_mean_square(found.directions[inner][..., 1, channel] + down[inner] / HEIGHT_PX) < 0.032
        slant = -3.0 * across / square
        assert root_mean_square(found.brightening[inner][..., channel] - brighter[inner]) < 0.0006
        assert root_mean_square(found.slanting[inner][..., 0, channel] - slant[inner]) < 0.001
        assert root_mean_square(brighter[inner]) > 0.0012
        assert root_mean_square(slant[inner]) > 0.002


def test_skin_that_looks_alike_at_every_elevation_tells_that_there_is_no_effect() -> None:
    found = measured(NearLamps(HEIGHT_PX), seen_at=0.0)
    assert found is not None
    assert not found.is_certain
    assert found.possible_fraction < 0.15


def test_lamps_far_away_are_no_evidence() -> None:
    found = measured(NearLamps(50 * HEIGHT_PX))
    assert found is None or not found.is_certain or found.nearness_per_px * HEIGHT_PX < 0.1


def test_too_few_balls_tell_nothing() -> None:
    assert measured(NearLamps(HEIGHT_PX), MIN_BALLS - 1) is None


def test_three_lamps_in_one_line_tell_nothing() -> None:
    lamps = NearLamps(HEIGHT_PX)
    shown = []
    for i, (ball, apex) in enumerate(balls()):
        image = lamps.intensity(press_px(ball, apex), noise=0.0, seed=i)
        image.values[:] = image.values[..., :1]
        shown.append((image, ball, apex))
    assert measure_elevation_response(shown, np.repeat(lamps.flat_field()[..., :1], 3, axis=-1)) is None
