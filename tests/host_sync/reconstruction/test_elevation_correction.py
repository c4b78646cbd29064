"""Slopes of skin that stands high, corrected by the heights that they integrate to."""

import numpy as np
import pytest

from device.surface.fields import GradientField
from host_sync.calibration.elevation_response import ElevationResponse
from host_sync.reconstruction.elevation_correction import at_cells, cell_means, correct_elevation, read_too_steep
from tests.apparatus.high_lamps import lamps_at

HEIGHT_PX = 300.0
SHAPE = (240, 320)


def lamps(height_px: float = HEIGHT_PX) -> ElevationResponse:
    return lamps_at(height_px)


def bump(shape: tuple[int, int] = SHAPE) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Elevation, pixels, and slopes of a smooth plateau amid untouched skin."""
    row, column = np.mgrid[: shape[0], : shape[1]].astype(float)
    distance = np.hypot(row - 0.5 * shape[0], column - 0.5 * shape[1])
    z = 15.0 / (1.0 + np.exp((distance - 0.25 * shape[0]) / 8.0))
    q, p = np.gradient(z)
    return z, p, q


def read(z: np.ndarray, p: np.ndarray, q: np.ndarray, response: ElevationResponse) -> GradientField:
    """What a map reads of a skin that the response describes."""
    wrong = read_too_steep(*(np.float32(part) for part in (p, q, z)), at_cells(response.as_slopes, z.shape))
    seen_p, seen_q = np.float32(p) + wrong[0], np.float32(q) + wrong[1]
    return GradientField(seen_p, seen_q, np.ones(z.shape, bool), np.ones(z.shape, np.float32))


def test_light_that_slants_more_is_read_too_steep_by_elevation_over_height() -> None:
    response = lamps()
    assert 1.0 / response.nearness_per_px == pytest.approx(HEIGHT_PX, rel=1e-4)
    flat = np.full((4, 4), 0.2, np.float32)
    wrong_p, wrong_q = read_too_steep(flat, 0 * flat, 30.0 + 0 * flat, at_cells(response.as_slopes, (4, 4)))
    np.testing.assert_allclose(wrong_p, 0.2 * 30.0 / HEIGHT_PX, rtol=1e-3)
    np.testing.assert_allclose(wrong_q, 0.0, atol=1e-6)


@pytest.mark.parametrize("shape", [SHAPE, (300, 1100)])
def test_a_plateau_is_read_right(shape: tuple[int, int]) -> None:
    z, p, q = bump(shape)
    field = read(z, p, q, lamps())
    before = float(np.abs(field.p - p).max())
    correct_elevation(field, lamps())
    assert before > 0.01
    assert float(np.abs(field.p - p).max()) < 0.1 * before
    assert float(np.abs(field.q - q).max()) < 0.1 * before


def test_elevation_that_is_known_is_that_of_the_same_skin_and_corrects_other_slopes() -> None:
    z, p, q = bump()
    quiet, noisy = read(z, p, q, lamps()), read(z, p, q, lamps())
    noise = np.float32(0.05) * np.random.default_rng(2).standard_normal(p.shape, dtype=np.float32)
    noisy.p[:] += noise
    known = correct_elevation(quiet, lamps())
    cell = -(-p.shape[1] // known.shape[1])
    top = known[int(p.shape[0] // 2 // cell), int(p.shape[1] // 2 // cell)]
    assert top == pytest.approx(z[p.shape[0] // 2, p.shape[1] // 2], rel=0.05)
    as_seen = noisy.p.copy()
    assert correct_elevation(noisy, lamps(), known) is known
    assert float(np.abs(noisy.p - as_seen).max()) > 0.01
    # What lies over the slopes is corrected as they are: at this elevation, not at what noise makes of it.
    np.testing.assert_allclose(noisy.p - quiet.p, noise, atol=0.01)
    level = read(z, p, q, lamps())
    seen = level.p.copy()
    correct_elevation(level, lamps(), 0.0 * known)
    np.testing.assert_array_equal(level.p, seen)


def test_untouched_skin_and_far_lamps_change_nothing() -> None:
    z, p, q = bump()
    flat = read(0 * z, 0 * p, 0 * q, lamps())
    correct_elevation(flat, lamps())
    np.testing.assert_array_equal(flat.p, 0.0)
    far = read(z, p, q, lamps(1e9))
    correct_elevation(far, lamps(1e9))
    np.testing.assert_allclose(far.p, p, atol=1e-5)


def test_pixels_without_a_slope_spoil_nothing() -> None:
    z, p, q = bump()
    field = read(z, p, q, lamps())
    hole = np.s_[10:30, 10:40]
    field.valid[hole] = False
    field.p[hole] = np.nan
    correct_elevation(field, lamps())
    assert float(np.abs(field.p - p)[field.valid].max()) < 0.002


def test_means_of_cells_leave_out_what_is_not_valid() -> None:
    p = np.arange(20, dtype=np.float32).reshape(4, 5)
    valid = np.ones((4, 5), bool)
    valid[0, 0] = valid[2:, 4] = False
    mean_p, _, known = cell_means(p, p, valid, 2)
    np.testing.assert_allclose(mean_p, [[4.0, 5.0, 6.5], [13.0, 15.0, 0.0]])
    np.testing.assert_array_equal(known, [[True, True, True], [True, True, False]])
