import re

import cv2
import numpy as np
import pytest

from device.align import Pose
from device.surface import HeightMap
from host_sync.errors import RegistrationRefused, ViewError
from host_sync.registration.difference import difference
from host_sync.registration.register import MIN_AGREEMENT, register

SHAPE = (300, 400)
PITCH_UM = 12.0


def scene(row: np.ndarray, column: np.ndarray) -> np.ndarray:
    hills = 40.0 * np.exp(-((row - 140.0) ** 2 + (column - 190.0) ** 2) / 50.0**2)
    marks = 12.0 * np.exp(-((row - 90.0) ** 2 + (column - 110.0) ** 2) / 12.0**2)
    return hills + marks + 6.0 * np.sin(column / 13.0 + np.sin(row / 25.0)) + 4.0 * np.cos(row / 17.0)


def seen(down: float = 0.0, right: float = 0.0, turn_deg: float = 0.0, noise_um: float = 0.0) -> HeightMap:
    """The scene shifted (px) and turned clockwise on the screen about the middle."""
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float64)
    middle = [(size - 1) / 2 for size in SHAPE]
    u, v = row - middle[0] - down, column - middle[1] - right
    turn = np.radians(turn_deg)
    z = scene(middle[0] + np.cos(turn) * u - np.sin(turn) * v, middle[1] + np.sin(turn) * u + np.cos(turn) * v)
    noise = np.random.default_rng(5).normal(0.0, 1.0, SHAPE) * noise_um
    return HeightMap((z + noise).astype(np.float32), PITCH_UM)


@pytest.mark.parametrize(("down", "right", "turn_deg"), [(0.0, 0.0, 0.0), (13.4, -22.7, 0.0), (-6.2, 9.9, 0.8)])
def test_shift_and_turn_are_found_to_a_part_of_a_pixel(down: float, right: float, turn_deg: float) -> None:
    found = difference(seen(), seen(down, right, turn_deg, noise_um=0.05))
    assert found.shift_um == pytest.approx((down * PITCH_UM, right * PITCH_UM), abs=0.03 * PITCH_UM)
    assert found.turn_deg == pytest.approx(turn_deg, abs=0.02)
    assert found.median_um < 0.1


def test_another_level_is_taken_off_and_said() -> None:
    column = np.arange(SHAPE[1], dtype=np.float32)
    other = seen(3.0, 5.0)
    tilted = HeightMap(other.z_um + np.float32(0.02) * column + np.float32(7.0), PITCH_UM)
    found = difference(seen(), tilted)
    assert found.tilt == pytest.approx((0.0, 0.02 / PITCH_UM), abs=2e-4)
    assert found.shift_um == pytest.approx((36.0, 60.0), abs=1.0)
    assert found.residual_um < 0.5


def test_what_really_differs_remains() -> None:
    second = seen(2.0, -3.0)
    second.z_um[200:220, 100:130] += 15.0
    found = difference(seen(), second)
    assert np.nanmedian(found.z_um[201:216, 106:130]) == pytest.approx(15.0, abs=0.5)
    assert found.median_um < 0.2


def test_a_nudged_round_thing_is_not_turned_either() -> None:
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float64)
    rng = np.random.default_rng(2)
    both = []
    for right in (0.0, 3.0):
        hill = 50.0 * np.exp(-((row - 149.5) ** 2 + (column - 199.5 - right) ** 2) / 40.0**2)
        both.append(HeightMap((hill + rng.normal(0.0, 0.3, SHAPE)).astype(np.float32), PITCH_UM))
    for turn in (0.0, 0.02):
        found = register(*both, near=Pose(1.0, 2.0, turn))
        assert found.pose.turn == turn
        assert found.pose.right == pytest.approx(3.0, abs=0.1)
    turned = register(seen(), seen(2.0, 3.0, 0.5), near=Pose(1.0, 1.0))
    assert np.degrees(turned.pose.turn) == pytest.approx(0.5, abs=0.02)


def test_what_is_not_turned_says_what_found_its_shift() -> None:
    second = seen(0.0, 4.0)
    found = register(seen(), second, frames=None)
    assert found.by in {"relief", "rim", "as they lie"}
    assert found.pose.turn == 0.0


def test_rivals_are_distinguished_in_words() -> None:
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float64)
    waves = 5.0 * np.sin(row / 6.0) * np.sin(column / 6.0)
    rng = np.random.default_rng(3)
    both = [HeightMap((waves + rng.normal(0.0, 0.5, SHAPE)).astype(np.float32), PITCH_UM) for _ in range(2)]
    found = register(*both)
    assert re.match(
        r"two places compete: the maps agree about as well \d+\.\d px (up|down) and \d+\.\d px (left|right).* from",
        found.refused,
    )


def test_a_round_thing_is_not_turned() -> None:
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float64)
    hill = 50.0 * np.exp(-((row - 149.5) ** 2 + (column - 199.5) ** 2) / 40.0**2)
    rng = np.random.default_rng(2)
    both = [HeightMap((hill + rng.normal(0.0, 0.3, SHAPE)).astype(np.float32), PITCH_UM) for _ in range(2)]
    assert difference(*both).turn_deg == 0.0


def test_invalid_pixels_of_either_are_invalid_in_the_difference() -> None:
    first, second = seen(), seen()
    first.z_um[50:60, 50:60] = np.nan
    second.z_um[150:160, 150:160] = np.nan
    found = difference(first, second)
    assert np.isnan(found.z_um[50:60, 50:60]).all()
    assert np.isnan(found.z_um[152:158, 152:158]).all()
    assert 0.9 < found.overlap_share < 1.0


def test_another_pitch_is_brought_to_the_first() -> None:
    fine = seen(4.0, 6.0)
    coarse = HeightMap(fine.z_um.reshape(150, 2, 200, 2).mean(axis=(1, 3)), 2 * PITCH_UM)
    found = difference(seen(), coarse)
    assert found.z_um.shape == SHAPE
    assert found.shift_um == pytest.approx((48.0, 72.0), abs=6.0)
    assert found.median_um < 0.5


def test_one_thing_seen_twice_agrees() -> None:
    assert difference(seen(), seen(13.4, -22.7, 0.5, noise_um=0.3)).warning == ""
    worn = seen(2.0, 3.0, noise_um=0.3)
    worn.z_um[150:230, 60:200] = 0.0
    assert difference(seen(), worn).warning == ""


@pytest.mark.parametrize(("size_px", "seed"), [pytest.param(3.0, 11, marks=pytest.mark.slow), (10.0, 12)])
def test_another_thing_is_refused(size_px: float, seed: int) -> None:
    random = np.random.default_rng(seed)
    rough = [cv2.GaussianBlur(random.standard_normal(SHAPE).astype(np.float32), (0, 0), size_px) for _ in range(2)]
    others = [HeightMap(20.0 * z_um / z_um.std(), PITCH_UM) for z_um in rough]
    for first, second in ((seen(), others[0]), (others[0], others[1])):
        found = register(first, second)
        assert found.agreement < MIN_AGREEMENT
        with pytest.raises(RegistrationRefused, match="may show different things"):
            difference(first, second)
        assert "may show different things" in difference(first, second, near=found.pose, pinned=True).warning


def test_the_difference_is_as_uncertain_as_both_together() -> None:
    sigmas = (np.full(SHAPE, 3.0, np.float32), np.full(SHAPE, 4.0, np.float32))
    found = difference(seen(), seen(5.0, 5.0), sigmas)
    assert found.sigma_um is not None
    np.testing.assert_array_equal(np.isfinite(found.sigma_um), np.isfinite(found.z_um))
    assert np.nanmax(np.abs(found.sigma_um - 5.0)) < 1e-3
    assert difference(seen(), seen(5.0, 5.0), (sigmas[0], None)).sigma_um is None


def test_nothing_in_common_is_refused() -> None:
    with pytest.raises(ViewError, match="no valid pixel"):
        difference(seen(), HeightMap(np.full(SHAPE, np.nan, np.float32), PITCH_UM))
