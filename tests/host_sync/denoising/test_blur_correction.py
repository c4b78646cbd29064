"""Heights without a camera's blur, against a Laplacian over whole arrays."""

from __future__ import annotations

import numpy as np
import pytest

from device.surface import HeightMap
from host_sync.denoising.slope_noise import without_blur

BLUR_PX = 0.6


def heights(shape: tuple[int, int]) -> np.ndarray:
    return np.random.default_rng(0).standard_normal(shape).astype(np.float32)


def corrected(z_um: np.ndarray) -> np.ndarray:
    """The same with the differences of pixels that are two apart; what is no number changes no other pixel."""
    wide = np.pad(z_um.astype(np.float64), 2, mode="edge")
    around = wide[:-4, 2:-2] + wide[4:, 2:-2] + wide[2:-2, :-4] + wide[2:-2, 4:]
    bend = 0.5 * BLUR_PX**2 * (around - 4.0 * z_um) / 4.0
    return z_um - np.where(np.isfinite(bend), bend, 0.0)


@pytest.mark.parametrize("shape", [(1, 1), (2, 3), (3, 4), (30, 5), (5, 30), (41, 52), (401, 403)])
def test_heights_lose_the_bend_that_blur_gave_them_up_to_the_border(shape: tuple[int, int]) -> None:
    z_um = heights(shape)
    found = without_blur(HeightMap(z_um, 7.0), BLUR_PX)
    np.testing.assert_allclose(found.z_um, corrected(z_um), atol=1e-5)
    assert found.z_um.dtype == np.float32
    assert found.pitch_um == 7.0


def test_holes_stay_and_reach_no_further() -> None:
    z_um = heights((40, 50))
    z_um[10:14, 20] = z_um[0, 0] = z_um[39, 48] = np.nan
    found = without_blur(HeightMap(z_um, 7.0), BLUR_PX).z_um
    np.testing.assert_array_equal(np.isfinite(found), np.isfinite(z_um))
    np.testing.assert_allclose(found, corrected(z_um), atol=1e-5)


def test_part_of_a_larger_map_is_as_its_copy_and_no_blur_changes_nothing() -> None:
    part = heights((40, 50))[3:31:3, 4:40:2]
    found = without_blur(HeightMap(part, 7.0), BLUR_PX).z_um
    np.testing.assert_array_equal(found, without_blur(HeightMap(part.copy(), 7.0), BLUR_PX).z_um)
    np.testing.assert_array_equal(without_blur(HeightMap(part, 7.0), 0.0).z_um, part)
