"""How much of a lamp arrives at cells: what stands in the way counts, the cell's own plane does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numba import get_num_threads, set_num_threads
from point_lamps import point_lamps

from device.surface.fields import Float32Array
from host_sync.lights import half_shadow
from host_sync.lights.half_shadow import ArrivingLight, arriving_light
from host_sync.lights.half_shadow_kernel import HALF_SHADOW, NEAR_SHADOW

CELL = 4
SHAPE = (160, 240)
CELLS = (40, 60)
RISE = 0.5
AFAR = 1000.0
"""Widths of the field: rays to a lamp so far away are parallel."""

MODEL = point_lamps(SHAPE, AFAR * np.array([[1.0, 0.0, RISE], [-1.0, 0.0, RISE], [0.0, 1.0, RISE]]))
COLUMN = np.broadcast_to(CELL * np.arange(CELLS[1], dtype=np.float32), CELLS)


def light_over(z_px: Float32Array) -> ArrivingLight:
    return arriving_light(np.ascontiguousarray(z_px, np.float32), CELL, MODEL)


def test_all_light_arrives_at_level_skin() -> None:
    light = light_over(np.zeros(CELLS, np.float32))
    assert not light.hidden.any()
    assert (light.visible == 1.0).all()
    assert (light.facing == 1.0).all()


def test_a_wall_hides_what_lies_behind_it_and_nothing_before_it() -> None:
    z = np.zeros(CELLS, np.float32)
    z[:, 30:34] = 32.0
    light = light_over(z)
    assert (light.visible[:, 20:28, 0] == 0.0).all()
    assert light.hidden[:, 20:28, 0].all()
    assert (light.visible[:, :10, 0] == 1.0).all()
    assert (light.visible[:, 36:, 0] == 1.0).all()
    assert (light.visible[:, 36:44, 1] == 0.0).all()
    assert (light.visible[..., 2, :] == 1.0).all()


@pytest.mark.parametrize("share", [0.0, 0.25, 0.5, 0.75, 1.0])
def test_half_of_a_light_arrives_where_its_ray_just_touches(share: float) -> None:
    """Level skin 20 cells before a ridge that its rays clear by a tangent of (2 share - 1) HALF_SHADOW."""
    z = np.zeros(CELLS, np.float32)
    z[:, 40] = 20 * CELL * (RISE - (2.0 * share - 1.0) * HALF_SHADOW)
    np.testing.assert_allclose(light_over(z).visible[:, 20, 0], share, atol=0.03)


@pytest.mark.parametrize(("clears", "hidden"), [(NEAR_SHADOW - 0.02, True), (NEAR_SHADOW + 0.02, False)])
def test_skin_near_a_shadow_may_be_hidden_and_is_lit_nevertheless(clears: float, hidden: bool) -> None:
    z = np.zeros(CELLS, np.float32)
    z[:, 40] = 20 * CELL * (RISE - clears)
    light = light_over(z)
    assert light.hidden[20, 20, 0] == hidden
    assert (light.visible[20, 20, 0] == 1.0).all()


@pytest.mark.parametrize(("slope", "hidden"), [(0.18, False), (0.22, True)])
def test_a_light_may_be_hidden_where_skin_turns_from_it(slope: float, hidden: bool) -> None:
    assert (light_over(slope * COLUMN).hidden[..., 0] == hidden).all()


def test_a_light_that_stands_low_is_not_hidden_for_that() -> None:
    low = point_lamps(SHAPE, AFAR * np.array([[1.0, 0.0, 0.1], [-1.0, 0.0, 0.1], [0.0, 1.0, 0.1]]))
    assert not arriving_light(np.zeros(CELLS, np.float32), CELL, low).hidden.any()
    tilted = arriving_light(np.float32(0.02) * COLUMN, CELL, low)
    assert tilted.hidden[..., 0].all()
    assert not tilted.hidden[..., 1:].any()


def test_round_skin_that_turns_away_is_hidden_by_nothing() -> None:
    """A ball read too steep would hide a light from itself, and would then be read steeper still."""
    z = -((COLUMN - COLUMN.max()) ** 2) / np.float32(400.0)
    slope = np.gradient(z, CELL, axis=1)
    turned = slope > RISE + HALF_SHADOW
    assert turned.mean() > 0.3
    light = light_over(z)
    assert (light.visible[..., 0, :] > 0.99).all()
    assert (light.facing[..., 0][turned] == 0.0).all()
    assert light.hidden[..., 0][turned].all()
    assert (light.facing[..., 0][slope < RISE - 0.1] == 1.0).all()


def test_points_of_a_strip_are_hidden_one_by_one() -> None:
    strip = replace(MODEL, position=np.array([[1.0, 0.0, 0.5], [-1.0, 0.6, 0.5], [-1.0, -0.6, 0.5]]), strip=1.0)
    z = np.zeros(CELLS, np.float32)
    z[:20, 45:] = 80.0
    light = arriving_light(z, CELL, strip)
    middle = light.visible[20, 30, 0]
    assert middle.min() < 0.1
    assert middle.max() == 1.0


NEAR = point_lamps(SHAPE, np.array([[0.1, -0.15, 0.2], [-3.0, 0.0, 1.5], [0.0, 3.0, 1.5]]))
NEAR_PX = np.array([0.1, -0.15, 0.2]) * SHAPE[1]
"""A lamp over the field, off its middle."""

MIDDLE = 0.5 * (CELL - 1)


@pytest.mark.parametrize("axis", [0, 1])
def test_rays_go_to_where_the_lamp_is(axis: int) -> None:
    wall, height_px = CELLS[axis] - 8, 8.0
    z = np.zeros(CELLS, np.float32)
    z.swapaxes(0, axis)[wall - 1 : wall + 1] = height_px
    place, lamp = CELL * np.arange(CELLS[axis]) + MIDDLE - 0.5 * (SHAPE[axis] - 1), NEAR_PX[1 - axis]
    passes_px = NEAR_PX[2] * (place - place[wall]) / (place - lamp)
    beyond = np.arange(CELLS[axis]) > wall + 1
    dark, lit = beyond & (passes_px < 0.7 * height_px), beyond & (passes_px > 1.3 * height_px)
    seen = arriving_light(z, CELL, NEAR).visible[..., 0, 0].swapaxes(0, axis)
    across = np.abs(np.arange(CELLS[1 - axis]) - CELLS[1 - axis] // 2) < 5
    assert dark.any()
    assert (seen[dark][:, across] == 0.0).all()
    assert lit.any()
    assert (seen[lit][:, across] == 1.0).all()


def test_what_stands_beyond_a_lamp_hides_it_from_nothing() -> None:
    z = np.zeros(CELLS, np.float32)
    z[:, 48:50] = 80.0
    seen = arriving_light(z, CELL, NEAR).visible[..., 0, 0]
    assert (seen[:, :34] == 1.0).all()
    assert (seen[:, 52:] == 0.0).all()


def test_rays_stride_over_nothing_that_comes_near_them(monkeypatch: pytest.MonkeyPatch) -> None:
    random = np.random.default_rng(4)
    z = np.zeros(CELLS, np.float32)
    for row, column, height in zip(*random.integers(0, CELLS, (12, 2)).T, random.uniform(10.0, 60.0, 12), strict=True):
        z[row : row + 3, column : column + 3] = height
    strides = light_over(z)
    # With skin of any height around it a ray takes every step of its way.
    monkeypatch.setattr(half_shadow.cv2, "dilate", lambda z_px, _: np.full_like(z_px, 1e6))
    steps = light_over(z)
    assert (steps.visible < 1.0).mean() > 0.05
    for name in ("hidden", "visible", "facing"):
        np.testing.assert_array_equal(getattr(strides, name), getattr(steps, name), err_msg=name)


def test_one_thread_finds_the_same() -> None:
    z = (20.0 * np.random.default_rng(2).random(CELLS)).astype(np.float32)
    threads = get_num_threads()
    found = light_over(z)
    assert 0.05 < (found.visible < 1.0).mean() < 0.95
    set_num_threads(1)
    try:
        alone = light_over(z)
    finally:
        set_num_threads(threads)
    np.testing.assert_array_equal(alone.visible, found.visible)
    np.testing.assert_array_equal(alone.hidden, found.hidden)
    np.testing.assert_array_equal(alone.facing, found.facing)
