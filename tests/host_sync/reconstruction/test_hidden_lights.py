"""How much light of a point arrives at cells: what stands in the way counts, the cell's own plane does not."""

from __future__ import annotations

import numpy as np

from device.surface.fields import Float32Array
from host_sync.reconstruction.hidden_lights import HALF_SHADOW, clearance, own_clearance, visible_share

SHAPE = (40, 60)
SLANT = 2.0
TOWARDS_COLUMNS = np.broadcast_to(np.array([-SLANT, 0.0]), (*SHAPE, 2))


def visible(z: Float32Array) -> np.ndarray:
    q, p = np.gradient(z)
    own = own_clearance(np.stack([p, q], axis=-1), TOWARDS_COLUMNS)
    return visible_share(clearance(z, 1.0, TOWARDS_COLUMNS), own)


def test_a_plane_clears_itself_by_the_light_less_its_slope() -> None:
    z = (0.2 * np.arange(SHAPE[1], dtype=np.float32) * np.ones(SHAPE, np.float32)).astype(np.float32)
    q, p = np.gradient(z)
    own = own_clearance(np.stack([p, q], axis=-1), TOWARDS_COLUMNS)
    np.testing.assert_allclose(own, 1.0 / SLANT - 0.2, rtol=1e-4)
    np.testing.assert_allclose(clearance(z, 1.0, TOWARDS_COLUMNS)[:, :40], own[:, :40], rtol=1e-3)


def test_a_wall_hides_what_lies_behind_it_and_nothing_before_it() -> None:
    z = np.zeros(SHAPE, np.float32)
    z[:, 30:34] = 8.0
    seen = visible(z)
    assert (seen[:, 20:28] == 0.0).all()
    assert (seen[:, :10] == 1.0).all()
    assert (seen[:, 36:] == 1.0).all()


def test_half_of_a_light_arrives_where_its_ray_just_touches() -> None:
    clear = np.array([-HALF_SHADOW, -0.5 * HALF_SHADOW, 0.0, 0.5 * HALF_SHADOW, HALF_SHADOW], np.float32)
    np.testing.assert_allclose(visible_share(clear, np.full_like(clear, 0.5)), [0.0, 0.25, 0.5, 0.75, 1.0], atol=1e-6)


def test_round_skin_that_turns_away_is_hidden_by_nothing() -> None:
    """A ball read too steep would hide a light from itself, and would then be read steeper still."""
    column = np.broadcast_to(np.arange(SHAPE[1], dtype=np.float32), SHAPE)
    z = -((column - 59.0) ** 2) / np.float32(100.0)
    _, slope = np.gradient(z)
    turned = slope > 1.0 / SLANT + HALF_SHADOW
    assert (clearance(z, 1.0, TOWARDS_COLUMNS)[turned] < 0.0).all()
    assert turned.mean() > 0.3
    assert (visible(z)[:, 1:] > 0.99).all()
