"""Fraction of a source that reaches cells, by geometry."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from matt_light import matt_model
from numba import get_num_threads, set_num_threads

from host_sync.light.cells import visible_fraction
from host_sync.light.model import LightModel

CELL = 4
SHAPE = (160, 240)
CELLS = (40, 60)
RISE = 0.5
AFAR = 1000.0
"""Widths of the field: rays to a source so far away are parallel."""


def lit_from(*sources: tuple[float, float, float, float]) -> LightModel:
    """Return a model of sources at these places and of these lengths, in widths of the field; none has a height."""
    panels = np.column_stack([np.array(sources), np.zeros(len(sources))])
    return replace(matt_model(200.0), shape=SHAPE, sources=panels, strengths=np.ones((3, len(sources))))


RIGHT_LEFT_BELOW = lit_from(*((AFAR * x, AFAR * y, AFAR * RISE, 0.0) for x, y in ((1, 0), (-1, 0), (0, 1))))
COLUMN = np.broadcast_to(CELL * np.arange(CELLS[1], dtype=np.float32), CELLS)


def seen(z_px: np.ndarray, model: LightModel = RIGHT_LEFT_BELOW) -> np.ndarray:
    return visible_fraction(np.ascontiguousarray(z_px, np.float32), CELL, model)


@pytest.mark.parametrize("rise", [0.02, 0.1, 0.5, 2.0])
def test_all_light_arrives_at_level_skin(rise: float) -> None:
    np.testing.assert_array_equal(seen(np.zeros(CELLS), lit_from((AFAR, 0.0, rise * AFAR, 0.0))), 1.0)


def test_a_wall_hides_what_lies_behind_it_and_nothing_before_it() -> None:
    """The shadow of 32 px at a tangent of 0.5 is 64 px long, 16 cells."""
    z = np.zeros(CELLS)
    z[:, 30:34] = 32.0
    found = seen(z)
    np.testing.assert_array_equal(found[:, 20:28, 0], 0.0)
    np.testing.assert_array_equal(found[:, :10, 0], 1.0)
    np.testing.assert_array_equal(found[:, 36:, 0], 1.0)
    np.testing.assert_array_equal(found[:, 36:44, 1], 0.0)
    np.testing.assert_array_equal(found[..., 2], 1.0)


def test_half_of_a_source_arrives_where_its_ray_just_touches() -> None:
    """Level skin 20 cells before a ridge."""

    def behind(tangent: float) -> float:
        z = np.zeros(CELLS)
        z[:, 40] = 20 * CELL * tangent
        return float(seen(z)[20, 20, 0])

    assert behind(RISE) == pytest.approx(0.5, abs=0.03)
    assert behind(RISE - 0.35) == 1.0
    assert behind(RISE + 0.35) == 0.0
    part = [behind(RISE + more) for more in np.linspace(-0.3, 0.3, 13)]
    assert part == sorted(part, reverse=True)


def test_round_skin_that_turns_away_is_hidden_by_nothing() -> None:
    """A ball whose slopes are estimated too steep would hide a light from itself, and would be steeper still."""
    z = -((COLUMN - COLUMN.max()) ** 2) / np.float32(400.0)
    assert (np.gradient(z, CELL, axis=1) > RISE + 0.1).mean() > 0.2
    assert seen(z)[..., 0].min() > 0.99


def test_a_strip_is_hidden_in_part() -> None:
    strip = lit_from((1.0, 0.0, 0.5, 1.0))
    z = np.zeros(CELLS)
    z[:20, 45:] = 80.0
    found = seen(z, strip)[..., 0]
    assert 0.1 < found[20, 30] < 0.9
    assert found[5, 35] < found[20, 35] < found[38, 35]


NEAR = (0.1, -0.15, 0.2)
"""A source over the field, off its middle."""


@pytest.mark.parametrize("axis", [0, 1])
def test_rays_go_to_where_the_source_is(axis: int) -> None:
    wall, height_px = CELLS[axis] - 8, 8.0
    z = np.zeros(CELLS)
    z.swapaxes(0, axis)[wall - 1 : wall + 1] = height_px
    place = CELL * np.arange(CELLS[axis]) + 0.5 * (CELL - 1) - 0.5 * (SHAPE[axis] - 1)
    source, up = NEAR[1 - axis] * SHAPE[1], NEAR[2] * SHAPE[1]
    passes_px = up * (place - place[wall]) / (place - source)
    beyond = np.arange(CELLS[axis]) > wall + 1
    dark, lit = beyond & (passes_px < 0.7 * height_px), beyond & (passes_px > 1.3 * height_px)
    found = seen(z, lit_from((*NEAR, 0.0)))[..., 0].swapaxes(0, axis)
    across = np.abs(np.arange(CELLS[1 - axis]) - CELLS[1 - axis] // 2) < 5
    assert dark.any()
    assert (found[dark][:, across] == 0.0).all()
    assert lit.any()
    assert (found[lit][:, across] == 1.0).all()


def test_what_stands_beyond_a_source_hides_it_from_nothing() -> None:
    z = np.zeros(CELLS)
    z[:, 48:50] = 80.0
    found = seen(z, lit_from((*NEAR, 0.0)))[..., 0]
    assert (found[:, :34] == 1.0).all()
    assert (found[:, 52:] == 0.0).all()


def test_one_thread_finds_the_same() -> None:
    z = 20.0 * np.random.default_rng(2).random(CELLS)
    threads, found = get_num_threads(), seen(z)
    assert 0.05 < (found < 1.0).mean() < 0.95
    set_num_threads(1)
    try:
        alone = seen(z)
    finally:
        set_num_threads(threads)
    np.testing.assert_array_equal(alone, found)
