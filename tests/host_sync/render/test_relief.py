from pathlib import Path

import cv2
import numpy as np
import pytest

from device.surface import HeightMap
from host_sync.render.relief_sheet import ReliefSheet, round_below, ticks, write_relief
from host_sync.render.shading import (
    exaggeration_for,
    flat_brightness,
    height_range_um,
    reduced,
    relief_rgb,
    shade,
    steep_slope,
    tint_table,
)


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
    assert (relief_rgb(height, low, high)[:, :4] == 255).all()


def test_shading_takes_central_differences_and_shows_what_it_exaggerates() -> None:
    z_um = np.random.default_rng(0).normal(0.0, 1.0, (20, 30)).astype(np.float32)
    q, p = np.gradient(z_um / 2.0)
    light = np.cos(np.radians(40.0)) * np.array([-np.sqrt(0.5), -np.sqrt(0.5), np.tan(np.radians(40.0))])
    for factor in (1.0, 3.0):
        cosine = (-factor * (p * light[0] + q * light[1]) + light[2]) / np.sqrt(1.0 + factor**2 * (p * p + q * q))
        expected = 0.15 + 0.85 * np.maximum(cosine, 0.0)
        np.testing.assert_allclose(shade(HeightMap(z_um, 2.0), exaggeration=factor), expected, atol=1e-5)


def test_flat_slopes_are_exaggerated_and_steep_ones_are_not() -> None:
    assert steep_slope(tilted(0.3, 0.4)) == pytest.approx(0.5, rel=1e-4)
    assert exaggeration_for(0.5) == 1.0
    assert exaggeration_for(0.07) == 5.0
    assert exaggeration_for(0.0) == 20.0


def test_a_flat_shows_the_tint_of_its_height() -> None:
    flat = HeightMap(np.full((20, 30), 30.0, np.float32), 1.0)
    shown = relief_rgb(flat, 0.0, 100.0)[10, 15].astype(float)
    np.testing.assert_allclose(shown, tint_table()[round(0.3 * 255)], atol=1.0)
    assert flat_brightness() == pytest.approx(float(shade(flat)[10, 15]))
    lightness = tint_table().sum(axis=1)
    assert (np.diff(lightness) > 0.0).all()


@pytest.mark.parametrize("shape", [(20, 600), (600, 20), (272, 364)])
def test_a_sheet_is_no_larger_than_relief_and_lettering_need(shape: tuple[int, int], tmp_path) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path / "relief.png"
    height = HeightMap(np.random.default_rng(0).normal(0.0, 9.0, shape).astype(np.float32), 12.0)
    write_relief(path, height, "a title that is much too long for a sheet as narrow as this one " * 3)
    picture = cv2.imread(str(path))
    enlarged = max(1, -(-320 // shape[1]))
    margin = 320
    assert shape[0] * enlarged < picture.shape[0] < shape[0] * enlarged + margin
    assert shape[1] * enlarged < picture.shape[1] < shape[1] * enlarged + margin
    inked = (picture < 200).any(axis=2)
    assert not inked[:, :5].any()
    assert not inked[:5].any()


def test_a_sheet_draws_every_relief_on_the_same_ground() -> None:
    sheet = ReliefSheet((100, 330), 12.0, (0.0, 50.0), title="press")
    low, high = (sheet.draw(HeightMap(np.full((100, 330), z, np.float32), 12.0)) for z in (0.0, 50.0))
    assert low.shape == (*sheet.shape, 3)
    assert sheet.shape[0] % 2 == sheet.shape[1] % 2 == 0
    differs = (low != high).any(axis=2)
    assert differs.sum() == 100 * 330
    captioned = sheet.draw(HeightMap(np.zeros((100, 330), np.float32), 12.0), "1.25 s")
    assert (captioned != low).any()


def test_scales_are_round() -> None:
    assert [round_below(value) for value in (1.0, 1.9, 0.049, 999.0, 1000.0)] == [1.0, 1.0, 0.02, 500.0, 1000.0]
    assert ticks(-3.0, 103.0, 10) == [0.0, 20.0, 40.0, 60.0, 80.0, 100.0]
    for low, high in ((0.0, 1.0), (-7.0, 7.3), (0.0, 9.99), (100.0, 100.001)):
        assert 1 <= len(ticks(low, high, 5)) <= 5


def test_reducing_keeps_heights_and_states_the_new_pitch() -> None:
    small = reduced(HeightMap(np.full((100, 300), 7.0, np.float32), 2.0), 100)
    assert small.z_um.shape == (33, 100)
    assert small.pitch_um == 6.0
    np.testing.assert_allclose(small.z_um, 7.0)


def test_a_height_map_without_a_valid_pixel_can_be_drawn(tmp_path) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path / "relief.png"
    write_relief(path, HeightMap(np.full((20, 30), np.nan, np.float32), 1.0), "nothing")
    assert path.stat().st_size > 1000


def test_a_relief_states_its_zero_and_hatches_what_is_extrapolated(tmp_path: Path) -> None:
    row, column = np.mgrid[:200, :400]
    height = HeightMap((20.0 * np.exp(-((row - 100) ** 2 + (column - 100) ** 2) / 900.0)).astype(np.float32), 10.0)
    beyond = np.asarray(column > 300)
    write_relief(tmp_path / "plain.png", height, "one")
    write_relief(tmp_path / "stated.png", height, "one", "no zero: heights are relative", beyond)
    plain, stated = (cv2.imread(str(tmp_path / f"{name}.png")) for name in ("plain", "stated"))
    assert plain is not None
    assert stated is not None
    assert stated.shape[0] > plain.shape[0]
    # Colours span the measured heights, which changes tints by a few counts.
    difference = np.abs(stated[: plain.shape[0], : plain.shape[1]].astype(int) - plain)
    changed = np.any(difference > 8, axis=-1)
    inside = changed[40:200]
    assert not inside[:, 20:300].any()
    assert 0.2 < inside[:, 330:400].mean() < 0.3
    assert (stated[plain.shape[0] :] < 128).any()


def test_colours_span_what_is_measured(tmp_path: Path) -> None:
    row, column = np.mgrid[:200, :400]
    hill = (20.0 * np.exp(-((row - 100) ** 2 + (column - 100) ** 2) / 900.0)).astype(np.float32)
    beyond = np.asarray(column > 380)
    deep = np.where(beyond, np.float32(-5000.0), hill)
    write_relief(tmp_path / "hill.png", HeightMap(hill, 10.0), "one", "", beyond)
    write_relief(tmp_path / "deep.png", HeightMap(deep, 10.0), "one", "", beyond)
    level, pit = (cv2.imread(str(tmp_path / f"{name}.png")) for name in ("hill", "deep"))
    assert level is not None
    assert pit is not None
    np.testing.assert_array_equal(level[40:200, 20:300], pit[40:200, 20:300])
