"""Elevation that the light of a field shows in which no skin rests."""

from __future__ import annotations

import numpy as np
import pytest
from matt_light import matt_model
from near_lamps import SHAPE, NearLamps, balls

from host_sync.kernels.cell_rows import means_of_cells, middles_of_cells
from host_sync.light.cells import Cells
from host_sync.light.reading import RaisedField, solve_raised

LAMP_PX = 180.0
LAMPS = NearLamps(LAMP_PX)
CELL = 4
SIZE = (SHAPE[0] // CELL, SHAPE[1] // CELL)
GAIN_SIGMA = 0.01


def spheres() -> np.ndarray:
    """Return the elevation of twelve shallow spheres side by side, pixels, zero on the mean."""
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    z = np.zeros(SHAPE)
    for ball, _ in balls():
        away = np.hypot(column - ball.column, row - ball.row)
        z = np.maximum(z, np.sqrt(np.maximum(150.0**2 - away**2, 0.0)) - 143.0)
    return z - z.mean()


def search(z_px: np.ndarray, gain: tuple[float, ...] = (1.0, 1.0, 1.0), sigma: float = 0.004) -> RaisedField | None:
    """Return what the light of a surface shows, from slopes that are as good as none."""
    image = LAMPS.intensity(z_px, noise=0.003)
    seen = means_of_cells(np.asarray(image.values * np.array(gain), np.float32), SIZE, CELL).reshape(-1, 3)
    row, column = middles_of_cells(SIZE, CELL)
    columns, rows = np.meshgrid(column, row)
    count = len(seen)
    q, p = np.gradient(z_px)
    start = means_of_cells(np.stack([p, q], axis=-1).astype(np.float32), SIZE, CELL).reshape(-1, 2)
    everywhere, flat = np.ones(count, bool), np.zeros((count, 2))
    model = matt_model(LAMP_PX, sigma)
    cells = Cells(model, SIZE, CELL, columns.ravel(), rows.ravel(), seen, everywhere, start, flat, prior_sigma=0.5)
    return solve_raised(cells, cells.solve(), GAIN_SIGMA)


def raised_px(found: RaisedField) -> float:
    return float(np.median(found.found.z_px))


@pytest.mark.parametrize("elevation_px", [-8.0, 8.0, 16.0])
@pytest.mark.parametrize("gain", [(1.0, 1.0, 1.0), (0.99, 1.0, 1.01)])
def test_the_elevation_of_spheres_that_fill_the_field_is_found(elevation_px: float, gain: tuple[float, ...]) -> None:
    z = spheres()
    found = search(z + elevation_px, gain)
    assert found is not None
    sigma_px = SHAPE[1] * float(np.sqrt(np.square(found.deviations[:, 0]).sum()))
    off_px = raised_px(found) - float(np.median(z)) - elevation_px
    assert abs(off_px) < max(3.0 * sigma_px, 0.5)
    assert sigma_px < 0.35 * abs(elevation_px)


@pytest.mark.parametrize("gain", [(1.0, 1.0, 1.0), (0.99, 1.0, 1.01)])
def test_skin_at_rest_is_not_raised(gain: tuple[float, ...]) -> None:
    assert search(np.zeros(SHAPE), gain) is None


def test_a_model_that_is_hardly_certain_shows_no_elevation() -> None:
    assert search(spheres() + 8.0, sigma=0.3) is None


def test_gains_are_taken_off() -> None:
    gain = (0.99, 1.0, 1.01)
    found = search(spheres() + 16.0, gain)
    assert found is not None
    image = LAMPS.intensity(spheres() + 16.0)
    plain = means_of_cells(image.values, SIZE, CELL).reshape(-1, 3)
    off = found.cells.intensity.mean(axis=0) / plain.mean(axis=0) - 1.0
    assert np.abs(off).max() < 0.006


def test_few_cells_show_nothing() -> None:
    row, column = middles_of_cells(SIZE, CELL)
    columns, rows = np.meshgrid(column, row)
    count = columns.size
    known, flat = np.zeros(count, bool), np.zeros((count, 2))
    known[:50] = True
    seen = np.ones((count, 3))
    model = matt_model(LAMP_PX)
    cells = Cells(model, SIZE, CELL, columns.ravel(), rows.ravel(), seen, known, flat, flat, prior_sigma=0.5)
    assert solve_raised(cells, cells.solve(), GAIN_SIGMA) is None
