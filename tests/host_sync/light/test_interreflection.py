"""Light from skin to skin, against form factors in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from host_sync.light.kernels import incoming_light

SIZE = (72, 96)
ROW, COLUMN = np.mgrid[: SIZE[0], : SIZE[1]].astype(np.float32)


def light_on(z_cells: np.ndarray, shown: float = 1.0) -> np.ndarray:
    """Return the light that skin of this elevation receives where all of it is equally bright: shape (h, w)."""
    q, p = (np.ascontiguousarray(part, np.float32) for part in np.gradient(z_cells))
    return incoming_light(np.full((*SIZE, 1), shown), p, q, np.asarray(z_cells, np.float32))[..., 0]


@pytest.mark.parametrize("slope", [0.5, 1.0])
def test_a_wall_of_a_groove_receives_the_form_factor_of_the_other(slope: float) -> None:
    """A strip at the distance x from the edge of a plane of the length L at the angle t to it receives
    (1 + (L cos t - x) / sqrt(L² + x² - 2 L x cos t)) / 2 of its radiance; x is half of L here.
    """
    half_width = 20.0
    z = slope * np.minimum(np.abs(COLUMN - 47.5), half_width)
    angle = np.pi - 2.0 * np.arctan(slope)
    at = 10.0
    part = at / half_width
    factor = 0.5 * (1.0 + (np.cos(angle) - part) / np.sqrt(1.0 + part**2 - 2.0 * part * np.cos(angle)))
    found = light_on(z)[36]
    for column in (47.5 - at, 47.5 + at):
        assert np.interp(column, COLUMN[0], found) == pytest.approx(factor, rel=0.1)


def test_level_skin_adds_nothing_and_no_convex_skin_receives_any() -> None:
    assert not light_on(np.zeros(SIZE)).any()
    assert not light_on(np.full(SIZE, 0.1)).any()
    ridge = -0.7 * np.abs(COLUMN - 47.5)
    assert np.abs(light_on(ridge)).max() < 1e-6


def test_twice_as_bright_skin_sends_twice_as_much() -> None:
    bowl = 0.01 * ((COLUMN - 47.5) ** 2 + (ROW - 35.5) ** 2)
    np.testing.assert_allclose(light_on(bowl, 2.0), 2.0 * light_on(bowl), rtol=1e-9)


def test_a_finer_grid_of_the_same_surface_receives_the_same() -> None:
    def bowl(finer: int) -> np.ndarray:
        row, column = (np.mgrid[: finer * SIZE[0], : finer * SIZE[1]] + 0.5) / finer
        z = 0.012 * ((column - 48.0) ** 2 + (row - 36.0) ** 2)
        q, p = (np.asarray(part * finer, np.float32) for part in np.gradient(z))
        shown = np.ones((*z.shape, 1))
        return incoming_light(shown, p, q, np.asarray(z * finer, np.float32))[..., 0]

    fine = bowl(2).reshape(SIZE[0], 2, SIZE[1], 2).mean(axis=(1, 3))
    np.testing.assert_allclose(fine[5:-5, 5:-5], bowl(1)[5:-5, 5:-5], atol=0.01)
