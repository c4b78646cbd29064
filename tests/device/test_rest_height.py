"""Heights of skin at rest are error: level by connected parts, smooth around them, invalid heights left out."""

import numpy as np
import pytest

from device.inverse_map.skin_at_rest import CALM, RESTING
from device.surface import HeightMap, enlarged, levels_apart_um, pit_um, rest_height

SHAPE = (96, 128)
CELLS = (24, 32)
ROW, COLUMN = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float32)


ALL_LIT = np.ones(CELLS, np.bool_)


PITCH_UM = 20.0
SURE = 0.001


def level_of(height: np.ndarray, cells: np.ndarray, lit: np.ndarray, slope_sigma: float = SURE) -> np.ndarray:
    return rest_height(HeightMap(height, PITCH_UM), lit & (cells < RESTING), lit & (cells < CALM), slope_sigma)


def kept(columns: slice, value: float) -> np.ndarray:
    """Cells at rest but for some columns, which keep a fraction of their slopes."""
    cells = np.zeros(CELLS, np.float32)
    cells[:, columns] = value
    return cells


@pytest.mark.parametrize(("between", "apart"), [(0.2, 0.0), (1.0, 80.0)])
def test_parts_that_calm_cells_connect_have_one_height_and_others_keep_theirs(between: float, apart: float) -> None:
    height = np.where(COLUMN < 64.0, 0.0, 80.0).astype(np.float32)
    found = level_of(height, kept(slice(14, 18), between), ALL_LIT)
    left, right = (np.median(height[:, part] - found.mean(axis=0)[cell]) for part, cell in ((5, 1), (120, 30)))
    assert right - left == pytest.approx(apart, abs=0.5)


def level_right(height: np.ndarray, slope_sigma: float) -> float:
    """The level of skin at rest on the right above that on the left, of heights that are not at rest between."""
    left_over = height[5] - np.repeat(level_of(height, kept(slice(10, 22), 1.0), ALL_LIT, slope_sigma)[1], 4)
    return float(np.median(left_over[100:]) - np.median(left_over[:28]))


@pytest.mark.parametrize(("slope_sigma", "apart"), [(0.03, 0.0), (SURE, 60.0)])
def test_gentle_skin_around_an_object_connects_skin_at_rest_as_far_as_slopes_are_uncertain(
    slope_sigma: float, apart: float
) -> None:
    drift_um = np.clip((COLUMN - 40.0) / 48.0, 0.0, 1.0) * 60.0
    ball_um = np.maximum(200.0 - 0.8 * ((COLUMN - 64.0) ** 2 + (ROW - 60.0) ** 2), 0.0)
    height = (drift_um + ball_um).astype(np.float32)
    assert level_right(height, slope_sigma) == pytest.approx(apart, abs=1.0)


def test_the_flank_of_a_low_step_connects_nothing_however_uncertain_slopes_are() -> None:
    height = np.clip((COLUMN - 56.0) / 16.0, 0.0, 1.0) * np.float32(8.0)
    assert level_right(height, 0.1) == pytest.approx(8.0, abs=0.2)


@pytest.mark.parametrize(("between_um", "apart_um"), [(20.0, 60.0), (1.0, 0.0)])
def test_skin_at_rest_that_lies_apart_without_a_steep_flank_is_found(between_um: float, apart_um: float) -> None:
    ball_um = np.maximum(200.0 - 0.8 * ((COLUMN - 64.0) ** 2 + (ROW - 60.0) ** 2), 0.0)
    rise_um = 60.0 * np.clip((COLUMN - 64.0) / (2.0 * between_um) + 0.5, 0.0, 1.0)
    heights = HeightMap((ball_um + rise_um).astype(np.float32), PITCH_UM)
    cells = kept(slice(10, 22), 1.0)
    assert levels_apart_um(heights, cells < RESTING, cells < CALM, SURE) == pytest.approx(apart_um, abs=0.1)
    flat = HeightMap(1e-4 * COLUMN, PITCH_UM)
    assert levels_apart_um(flat, cells < RESTING, cells < CALM, SURE) == 0.0


@pytest.mark.parametrize(
    ("boss_um", "recess_um", "pit"), [(200.0, 100.0, 100.0), (200.0, 20.0, 0.0), (10.0, 100.0, 0.0)]
)
def test_a_pit_near_an_object_is_found_and_an_engraved_surface_is_none(
    boss_um: float, recess_um: float, pit: float
) -> None:
    height = np.zeros(SHAPE, np.float32)
    height[20:60, 20:60] = boss_um
    height[40:80, 80:120] = -recess_um
    height[:4, :4] = np.nan
    assert pit_um(HeightMap(height, PITCH_UM), CELLS, SURE) == pytest.approx(pit)


def test_unevenness_of_untouched_skin_is_no_pit() -> None:
    uneven = HeightMap(np.asarray(0.02 * np.sin(COLUMN / 9.0), np.float32), PITCH_UM)
    assert pit_um(uneven, CELLS, SURE) == 0.0


def test_the_largest_part_is_zero() -> None:
    height = np.where(COLUMN < 40.0, -30.0, 50.0).astype(np.float32)
    found = level_of(height, kept(slice(9, 11), 1.0), ALL_LIT)
    assert found[12, 25] == pytest.approx(50.0, abs=0.1)
    assert found[12, 3] == pytest.approx(50.0, abs=0.1)


def test_invalid_heights_are_left_out() -> None:
    height = (0.3 * COLUMN + 7.0).astype(np.float32)
    whole = level_of(height, kept(slice(8, 12), 1.0), ALL_LIT)
    holes = height.copy()
    holes[::4, ::4] = np.nan
    holes[:20, :30] = np.nan
    found = level_of(holes, kept(slice(8, 12), 1.0), ALL_LIT)
    assert np.isfinite(found).all()
    assert np.abs(found - whole)[6:, 12:].max() < 0.3


def test_without_skin_at_rest_nothing_is_subtracted() -> None:
    height = COLUMN.copy()
    assert not level_of(height, np.ones(CELLS, np.float32), ALL_LIT).any()
    assert not level_of(np.full(SHAPE, np.nan, np.float32), np.zeros(CELLS, np.float32), ALL_LIT).any()
    assert not level_of(height, np.zeros(CELLS, np.float32), ~ALL_LIT).any()


def test_cells_without_light_are_not_at_rest() -> None:
    height = np.where(COLUMN < 64.0, 0.0, 60.0).astype(np.float32)
    cells, lit = kept(slice(14, 28), 1.0), ALL_LIT.copy()
    lit[:, 28:] = False
    found = level_of(height, cells, lit)
    assert np.abs(found).max() < 0.5
    assert found[12, 30] == pytest.approx(found[12, 20], abs=0.5)


def lifted(height: np.ndarray, cells: np.ndarray, weight: np.ndarray, slope_sigma: float = 0.03) -> np.ndarray:
    """Heights without their error, where the information of slopes is known."""
    heights = HeightMap(height.astype(np.float32), PITCH_UM)
    error = rest_height(heights, cells < RESTING, cells < CALM, slope_sigma, weight.astype(np.float32))
    return height - enlarged(error, height.shape)


def test_a_moat_around_an_object_is_lifted_and_the_object_keeps_its_shape() -> None:
    away = np.hypot(COLUMN - 64.0, ROW - 48.0)
    cell_away = np.hypot(*(np.mgrid[: CELLS[0], : CELLS[1]] * 4.0 + 1.5 - np.array([48.0, 64.0])[:, None, None]))
    ball = np.maximum(300.0 - 1.5 * away**2, 0.0)
    moat = 25.0 * np.sin(np.pi * np.clip((away - 12.0) / 30.0, 0.0, 1.0)) ** 2
    z_um = lifted(ball - moat, (cell_away < 42.0).astype(np.float32), np.where(cell_away < 14.0, 1.0, 0.1))
    assert (ball - moat).min() < -24.0
    assert z_um.min() > -14.0
    assert np.ptp((z_um - ball)[away < 9.0]) < 6.0


@pytest.mark.parametrize("depth_um", [8.0, 80.0])
def test_a_groove_across_a_plate_is_no_moat(depth_um: float) -> None:
    groove = -depth_um * np.clip(2.0 - np.abs(COLUMN - 64.0) / 8.0, 0.0, 1.0)
    z_um = lifted(groove, kept(slice(11, 21), 1.0), np.ones(CELLS))
    assert z_um[:, 60:68].mean() == pytest.approx(-depth_um, rel=0.02)


def test_a_recess_next_to_a_higher_boss_keeps_its_depth() -> None:
    recess = -40.0 * np.clip(3.0 - np.abs(COLUMN - 44.0) / 3.0, 0.0, 1.0)
    boss = 150.0 * np.clip(3.0 - np.abs(COLUMN - 84.0) / 3.0, 0.0, 1.0)
    cells = np.maximum(kept(slice(8, 14), 1.0), kept(slice(18, 24), 1.0))
    z_um = lifted(recess + boss, cells, np.ones(CELLS))
    assert z_um[:, 42:46].mean() == pytest.approx(-40.0, rel=0.05)
    assert z_um[:, 82:86].mean() == pytest.approx(150.0, rel=0.02)
