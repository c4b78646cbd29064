"""Random numbers of slope errors: the same whenever they are drawn, with the variance that is said."""

from __future__ import annotations

import numpy as np
import pytest

from host_sync.uncertainty.elevation import ElevationCorrection
from host_sync.uncertainty.height_error import SAMPLES, SlopeDraws, slope_draws
from host_sync.uncertainty.slope_error import SlopeError

SIZE = (96, 64)
PATCH_PX = 12.0
REDUCTION = 4
ERROR = SlopeError((0.0, 60.0), (1.0, 1.0), (0.5, 0.5), PATCH_PX, ElevationCorrection(20.0, 80.0, 0.0), ((0.01, 0.01),))


def drawn(fields: int = 2) -> SlopeDraws:
    return slope_draws(ERROR, SIZE, REDUCTION * SIZE[0], fields)


def test_they_are_the_same_each_time() -> None:
    first, _, second = drawn(), drawn(3), drawn()
    assert first is not second, "only the last draws are kept"
    for name in ("shared", "local", "pixels", "patches", "spread"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))


def test_they_are_kept_for_the_next_scan_and_nothing_may_be_written_to_them() -> None:
    draws = drawn()
    assert drawn() is draws
    with pytest.raises(ValueError, match="read-only"):
        draws.pixels[:] = 0.0


def test_every_field_has_a_number_of_its_own() -> None:
    more = drawn(5).shared.shape[1] - drawn(2).shared.shape[1]
    assert more == 3
    assert drawn().pixels.shape == drawn().patches.shape == (SAMPLES, 2, *SIZE[::-1])


def test_pixels_are_independent_and_patches_reach_as_far_as_said_on_the_reduced_field() -> None:
    draws = drawn()
    assert draws.pixels.std() == pytest.approx(1.0, abs=0.01)
    np.testing.assert_allclose(draws.spread, draws.patches.std(axis=(2, 3)), rtol=1e-5)

    def alike(fields: np.ndarray, apart_px: int) -> float:
        return float((fields[..., apart_px:] * fields[..., :-apart_px]).mean() / fields.var())

    assert abs(alike(draws.pixels, 1)) < 0.02
    # White noise under a Gaussian of σ keeps exp(-d² / 4σ²) of its variance at the distance d.
    reach_px = PATCH_PX / REDUCTION
    for apart_px in (2, 4):
        assert alike(draws.patches, apart_px) == pytest.approx(np.exp(-0.25 * (apart_px / reach_px) ** 2), abs=0.05)
