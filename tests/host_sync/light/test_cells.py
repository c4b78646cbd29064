"""The search for slopes of cells, against the model that predicts their intensity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from matt_light import matt_model
from near_lamps import SHAPE

from host_sync.kernels.cell_rows import cell_px, middles_of_cells
from host_sync.light.cells import Cells, CellSlopes
from host_sync.light.model import LightModel

RANDOM = np.random.default_rng(1)
MATT = matt_model(200.0)
FULL = replace(
    MATT,
    sources=MATT.sources + np.array([0.0, 0.0, 0.0, 0.3, 0.4]),
    strengths=np.eye(3) + 0.1,
    haze=np.full(3, 0.03),
    albedo=0.4,
    fall_off=1.7,
    roughness=0.4,
    gloss=0.15,
    tilt_gain=0.1,
    scattering=0.2,
    beam=0.4,
    camera=0.2,
    residual=RANDOM.normal(0.0, 0.004, MATT.residual.shape),
)
CELL = 8 * cell_px(SHAPE)
SIZE = (SHAPE[0] // CELL, SHAPE[1] // CELL)
COUNT = SIZE[0] * SIZE[1]
TRUTH = RANDOM.uniform(-0.35, 0.35, (COUNT, 2))
Z_PX = RANDOM.uniform(-5.0, 20.0, SIZE).astype(np.float32)
STEPS = 20


def cells_with(model: LightModel, start: np.ndarray, prior_sigma: float = 10.0) -> Cells:
    row, column = middles_of_cells(SIZE, CELL)
    columns, rows = np.meshgrid(column, row)
    everywhere, seen = np.ones(COUNT, bool), np.ones((COUNT, 3))
    return Cells(
        model,
        SIZE,
        CELL,
        columns.ravel(),
        rows.ravel(),
        intensity=seen,
        faithful=everywhere,
        start=start,
        bend=np.zeros((COUNT, 2)),
        prior_sigma=prior_sigma,
    )


def lit(cells: Cells, found: CellSlopes, slope: np.ndarray, hidden: tuple[int, ...] = ()) -> np.ndarray:
    """Return the intensity of slopes over what was found around them, without the light of hidden sources."""
    model, places = cells.model, cells.places(Z_PX)
    dark = model.light(*slope.T, *places)[:, list(hidden)] @ model.strengths[:, list(hidden)].T
    return model.intensity(slope, places, found.incoming) - dark / model.rest(*places[:2])


@pytest.mark.parametrize("model", [MATT, FULL], ids=["matt", "full"])
def test_slopes_move_to_those_that_the_model_predicts(model: LightModel) -> None:
    cells = cells_with(model, TRUTH + RANDOM.uniform(-0.05, 0.05, TRUTH.shape))
    before = CellSlopes.level(cells)
    cells = replace(cells, intensity=lit(cells, before, TRUTH))
    found = cells.solve_at(before, Z_PX, STEPS)
    np.testing.assert_allclose(found.slope, TRUTH, atol=2e-4)


def test_changes_are_derivatives_of_the_intensity() -> None:
    cells = cells_with(FULL, TRUTH)
    before = CellSlopes.level(cells)
    cells = replace(cells, intensity=lit(cells, before, TRUTH))
    found = cells.solve_at(before, Z_PX, STEPS)
    for axis, step in enumerate(1e-5 * np.eye(2)):
        ahead, behind = (lit(cells, before, found.slope + sign * step) for sign in (1.0, -1.0))
        off = np.abs(found.change[..., axis] - (ahead - behind) / 2e-5)
        # A rough coat has a kink where light and camera see a slope from the same angle.
        assert np.quantile(off, 0.98) < 0.005
        assert off.max() < 0.1


def test_the_other_sources_determine_slopes_where_one_is_hidden() -> None:
    cells = cells_with(MATT, TRUTH + 0.03)
    visible = np.tile([0.0, 1.0, 1.0], (COUNT, 1))
    before = replace(CellSlopes.level(cells), visible=visible)
    cells = replace(cells, intensity=lit(cells, before, TRUTH, hidden=(0,)))
    found = cells.solve_at(before, Z_PX, STEPS)
    np.testing.assert_allclose(lit(cells, before, found.slope, hidden=(0,)), cells.intensity, atol=1e-4)
    # Two lights have two slopes of one intensity, which meet somewhere.
    assert np.quantile(np.abs(found.slope - TRUTH), 0.95) < 1e-3


def test_what_is_expected_counts_as_far_as_it_is_more_certain_than_the_light() -> None:
    start = TRUTH + 0.02

    def off(sigma: float, prior_sigma: float) -> float:
        cells = cells_with(replace(MATT, sigma=np.full(3, sigma)), start, prior_sigma)
        before = CellSlopes.level(cells)
        found = replace(cells, intensity=lit(cells, before, TRUTH)).solve_at(before, Z_PX, STEPS)
        return float(np.abs(found.slope - TRUTH).mean())

    assert off(sigma=0.001, prior_sigma=1.0) < 1e-4
    assert off(sigma=1.0, prior_sigma=0.001) == pytest.approx(0.02, rel=0.01)
    assert off(0.01, 0.1) < off(0.01, 0.01) < off(0.01, 0.001)


def test_the_light_of_cells_that_are_not_known_moves_nothing() -> None:
    cells = cells_with(MATT, TRUTH, prior_sigma=0.1)
    before = CellSlopes.level(cells)
    seen = lit(cells, before, TRUTH)
    unknown = np.arange(COUNT) % 3 == 0
    one, other = (
        replace(cells, intensity=np.where(unknown[:, None], value, seen), faithful=~unknown).solve_at(before, Z_PX, 3)
        for value in (0.2, 5.0)
    )
    np.testing.assert_array_equal(one.slope, other.slope)
    assert not one.weight[unknown].any()
