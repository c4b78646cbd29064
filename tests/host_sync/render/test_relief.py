import numpy as np
import pytest

from device.surface import HeightMap
from host_sync.render.relief import height_range_um, relief_rgb, write_relief
from host_sync.render.shading import reduced, shade


def tilted(across: float, down: float) -> HeightMap:
    row, column = np.mgrid[:20, :30].astype(np.float32)
    return HeightMap(across * column + down * row, 1.0)


def brightness(across: float, down: float) -> float:
    return float(shade(tilted(across, down))[10, 15])


def test_slopes_that_face_the_upper_left_are_bright() -> None:
    # Rising to the right and downwards is falling towards the light at the upper left: such a slope faces it.
    assert brightness(0.5, 0.5) > brightness(0.0, 0.0) > brightness(-0.5, -0.5)


def test_the_light_can_be_moved() -> None:
    rising = tilted(0.5, 0.0)
    assert shade(rising, azimuth_deg=180.0)[10, 15] > shade(rising, azimuth_deg=0.0)[10, 15]


def test_a_flat_is_as_bright_as_the_light_is_high() -> None:
    flat = tilted(0.0, 0.0)
    assert shade(flat, elevation_deg=90.0)[10, 15] == pytest.approx(1.0)
    assert shade(flat, elevation_deg=30.0)[10, 15] < 0.7


def test_invalid_pixels_are_white_and_do_not_spread_into_the_range() -> None:
    height = tilted(1.0, 0.0)
    height.z_um[:, :5] = np.nan
    low, high = height_range_um(height)
    assert (low, high) == pytest.approx((5.0, 29.0), abs=0.1)
    assert (relief_rgb(height, low, high)[:, :4] == 1.0).all()


def test_reducing_keeps_heights_and_states_the_new_pitch() -> None:
    small = reduced(HeightMap(np.full((100, 300), 7.0, np.float32), 2.0), 100)
    assert small.z_um.shape == (33, 100)
    assert small.pitch_um == 6.0
    np.testing.assert_allclose(small.z_um, 7.0)


def test_a_height_map_without_a_valid_pixel_can_be_drawn(tmp_path) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path / "relief.png"
    write_relief(path, HeightMap(np.full((20, 30), np.nan, np.float32), 1.0), "nothing")
    assert path.stat().st_size > 1000
