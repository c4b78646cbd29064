"""What blur takes from a wave is known in closed form; of a plane and around a hole it takes nothing."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from host_sync.uncertainty.calibration_uncertainty import BLUR_PX, unresolved_slope

SHAPE = (120, 160)
ROW, COLUMN = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)


@pytest.mark.parametrize("length_px", [16.0, 24.0, 40.0])
def test_a_wave_lacks_what_the_blur_took(length_px: float) -> None:
    p = 0.2 * np.cos(2.0 * np.pi * COLUMN / length_px)
    lost = (p - gaussian_filter(p, BLUR_PX))[20:-20, 20:-20]
    stated = unresolved_slope(p.astype(np.float32), np.zeros(SHAPE, np.float32))[6:-6, 6:-6]
    # Of two components one alone lacks something.
    assert np.sqrt((stated**2).mean()) == pytest.approx(np.sqrt((lost**2).mean() / 2.0), rel=0.15)


def test_planes_and_holes_lack_nothing() -> None:
    p = np.full(SHAPE, 0.3, np.float32)
    p[50:60, 70:90] = np.nan
    assert unresolved_slope(p, p).max() < 1e-6


def test_an_edge_is_unsure_near_itself_only() -> None:
    p = np.where(np.abs(COLUMN - 80.0) < 2.0, 0.5, 0.0).astype(np.float32)
    stated = unresolved_slope(p, np.zeros(SHAPE, np.float32))
    assert stated[15, 20] > 0.02
    assert stated[15, :12].max() < 1e-4
