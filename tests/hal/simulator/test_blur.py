"""Blur of a board's twin: what the f-number and the height of the skin make of a point of light, and of a figure."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from hal.board_profile import BoardProfile, load_board_profile
from hal.errors import BoardProfileError
from hal.profile_tables import LensConfig
from hal.simulator.lens import Blur, Lens, blur_of
from hal.simulator.scene import twin_of

LENS = LensConfig(focal_mm=25.0, f_number=4.0, pixel_um=3.45)
PITCH_UM = 12.0


def spread_px(blur: Blur, height_mm: float) -> float:
    """Standard deviation of a point's image along columns on a skin of even height."""
    point = np.zeros((81, 81), np.float32)
    point[40, 40] = 1.0
    seen = blur.spread(point, np.full_like(point, height_mm))
    assert seen.sum() == pytest.approx(1.0, rel=1e-3)
    return float(np.sqrt((seen * (np.arange(81) - 40.0) ** 2).sum()))


@pytest.mark.parametrize("f_number", [2.0, 4.0, 8.0])
@pytest.mark.parametrize("height_mm", [-0.6, 0.6, 1.2])
def test_a_point_spreads_as_airy_pixel_and_defocus_in_quadrature(f_number: float, height_mm: float) -> None:
    blur = blur_of(msgspec.structs.replace(LENS, f_number=f_number), PITCH_UM)
    magnification = 3.45 / 12.0
    airy_um = 0.42 * 0.53 * f_number * (1.0 + magnification) / magnification
    disc_um = 1e3 * abs(height_mm) / (f_number * (1.0 + 1.0 / magnification)) / 1.41
    sigma_px = np.sqrt(airy_um**2 + (disc_um / 4.0) ** 2 + PITCH_UM**2 / 12.0) / PITCH_UM
    assert spread_px(blur, height_mm) == pytest.approx(sigma_px, rel=0.03)


def test_a_stop_trades_detail_in_focus_against_depth() -> None:
    open_wide, stopped = (blur_of(msgspec.structs.replace(LENS, f_number=f), PITCH_UM) for f in (2.8, 8.0))
    assert spread_px(open_wide, 0.0) < spread_px(stopped, 0.0)
    assert spread_px(open_wide, 1.0) > spread_px(stopped, 1.0)


def test_the_plane_in_focus_can_stand_above_the_skin() -> None:
    blur = blur_of(msgspec.structs.replace(LENS, f_number=1.4, focus_mm=0.5), PITCH_UM)
    assert spread_px(blur, 0.5) < spread_px(blur, 0.0) == pytest.approx(spread_px(blur, 1.0), rel=1e-3)


def test_blur_changes_with_the_height_of_the_skin_within_one_picture() -> None:
    blur = blur_of(msgspec.structs.replace(LENS, f_number=1.4), PITCH_UM)
    stripes = np.tile(np.asarray([0.0, 0.0, 0.0, 1.0, 1.0, 1.0], np.float32), (64, 20))
    height_mm = np.zeros_like(stripes)
    height_mm[:, 60:] = 1.2
    seen = blur.spread(stripes, height_mm)
    low, high = seen[:, 12:48].std(), seen[:, 72:108].std()
    assert high < 0.5 * low
    assert low == pytest.approx(blur.spread(stripes, np.zeros_like(stripes))[:, 12:48].std(), rel=1e-5)


def test_even_light_stays_even_on_a_slope() -> None:
    blur = blur_of(LENS, PITCH_UM)
    height_mm = np.linspace(-0.5, 1.5, 128, dtype=np.float32)[None, :].repeat(64, axis=0)
    np.testing.assert_allclose(blur.spread(np.ones_like(height_mm), height_mm), 1.0, atol=1e-5)


@pytest.mark.parametrize("board", ["pi5-imx296", "pi4-imx477-binned", "pi4-imx477", "zero2w-imx708"])
def test_the_twin_of_a_board_is_as_sharp_as_its_lens(board: str) -> None:
    twin = twin_of(load_board_profile(board))
    assert twin.driver == "twin"
    lens = Lens.of(twin)
    assert twin.lens is not None
    assert lens.blur == blur_of(twin.lens, twin.sensor.pixel_pitch_um)
    in_air_mm = twin.lens.focal_mm * (1.0 + twin.sensor.pixel_pitch_um / twin.lens.pixel_um)
    assert lens.distance_mm == pytest.approx(1.41 * in_air_mm)  # seen from inside silicone
    assert twin.pupil_height_mm == pytest.approx(lens.distance_mm)


def test_without_a_lens_there_is_no_twin_of_a_board(profile: BoardProfile) -> None:
    assert Lens.of(profile).blur is None
    with pytest.raises(BoardProfileError, match=r"has no \[lens\] table"):
        twin_of(profile)
