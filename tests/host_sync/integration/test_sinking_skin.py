"""Skin that sinks from an object towards rest beyond the border, in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from device.surface import GradientField, HeightMap
from host_sync.integration.zero_level import MAX_LEFT, ZERO_SIGMA_BY_SPREAD, Datum, _unbent_at, height_left_um

SHAPE = (240, 320)
PITCH_UM = 20.0
LENGTH_PX = 40.0
TOP_UM = 400.0


def ridge(noise: float = 0.0) -> tuple[np.ndarray, GradientField]:
    """A plateau across the field and skin beside it that falls off with exp(-x / L): a membrane on springs, µm."""
    column = np.arange(SHAPE[1]) + 0.0 * np.arange(SHAPE[0])[:, None]
    away = np.maximum(np.abs(column - 0.5 * (SHAPE[1] - 1)) - 30.0, 0.0)
    z_um = TOP_UM * np.exp(-away / LENGTH_PX)
    q, p = np.gradient(z_um / PITCH_UM)
    random = np.random.default_rng(0)
    p, q = (part + noise * random.standard_normal(SHAPE) for part in (p, q))
    everywhere = np.ones(SHAPE, bool)
    return z_um, GradientField(p.astype(np.float32), q.astype(np.float32), everywhere, np.ones(SHAPE, np.float32))


def left_um(zero_um: float, noise: float = 0.0) -> float:
    z_um, gradients = ridge(noise)
    height = HeightMap(z_um.astype(np.float32), PITCH_UM)
    resting = z_um < 2.0 * z_um.min()
    return height_left_um(height, gradients, resting, zero_um)


def test_the_bend_of_free_skin_shows_how_far_it_sinks_yet() -> None:
    lowest = TOP_UM * np.exp(-(0.5 * (SHAPE[1] - 1) - 30.0) / LENGTH_PX)
    assert 10.0 < lowest < MAX_LEFT * TOP_UM
    assert left_um(float(lowest)) == pytest.approx(lowest, rel=0.1)
    assert left_um(float(lowest), noise=0.002) == pytest.approx(lowest, rel=0.25)
    assert left_um(0.0) == pytest.approx(0.0, abs=1.0)


def test_no_more_is_taken_off_than_a_share_of_the_height_and_nothing_below_rest() -> None:
    assert left_um(200.0) <= MAX_LEFT * TOP_UM
    assert left_um(-30.0) == 0.0


def test_skin_that_bends_as_no_free_skin_does_shows_nothing() -> None:
    random = np.random.default_rng(1)
    z_um = 50.0 * random.standard_normal(SHAPE)
    q, p = np.gradient(z_um / PITCH_UM)
    everywhere = np.ones(SHAPE, bool)
    field = GradientField(p.astype(np.float32), q.astype(np.float32), everywhere, np.ones(SHAPE, np.float32))
    assert height_left_um(HeightMap(z_um.astype(np.float32), PITCH_UM), field, everywhere, 0.0) == 0.0


def test_a_zero_at_rest_lies_lower_and_is_less_sure() -> None:
    z_um, gradients = ridge()
    height = HeightMap(z_um.astype(np.float32), PITCH_UM)
    resting = z_um < 2.0 * z_um.min()
    datum = Datum(resting, float(z_um[resting].mean()), 1.0, float(resting.mean()))
    at_rest = datum.at_rest(height, gradients)
    assert abs(at_rest.zero_um) < 0.4 * datum.zero_um
    assert at_rest.zero_sigma_um == pytest.approx(
        np.hypot(ZERO_SIGMA_BY_SPREAD, 0.5 * (datum.zero_um - at_rest.zero_um)), rel=1e-5
    )
    assert Datum(resting, 5.0, 1.0, 0.0).at_rest(height, gradients).zero_um == 5.0


@pytest.mark.parametrize("correlation", [0.3, 0.6])
def test_bends_that_follow_heights_loosely_show_nothing(correlation: float) -> None:
    """Leaving out what lies off the line must not make a line of a cloud."""
    random = np.random.default_rng(2)
    z, noise = random.standard_normal((2, 3000))
    bend = correlation * z + np.sqrt(1.0 - correlation**2) * noise
    assert _unbent_at(z, bend - 1.0) == 0.0


@pytest.mark.parametrize("shape", [(1, 1), (1, 320), (3, 320), (320, 1), (7, 800)])
def test_a_field_of_few_cells_shows_nothing(shape: tuple[int, int]) -> None:
    flat, everywhere = np.zeros(shape, np.float32), np.ones(shape, bool)
    gradients = GradientField(flat, flat, everywhere, np.ones(shape, np.float32))
    assert height_left_um(HeightMap(flat, PITCH_UM), gradients, everywhere, 1.0) == 0.0


def test_cells_that_the_border_cuts_do_not_count() -> None:
    z_um, gradients = ridge()
    rows, columns = SHAPE[0] - 1, SHAPE[1] - 1
    spoilt, whole = z_um.astype(np.float32), z_um.astype(np.float32)[: rows - 1, : columns - 1]
    spoilt = spoilt[:rows, :columns]
    spoilt[-1], spoilt[:, -1] = 9e3, 9e3

    def left(z: np.ndarray) -> float:
        own = (
            part[: z.shape[0], : z.shape[1]] for part in (gradients.p, gradients.q, gradients.valid, gradients.weight)
        )
        resting = z_um[: z.shape[0], : z.shape[1]] < 2.0 * z_um.min()
        return height_left_um(HeightMap(z, PITCH_UM), GradientField(*own), resting, 20.0)

    assert left(spoilt) == left(whole) > 0.0
