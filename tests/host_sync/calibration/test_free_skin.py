"""What the reference missed of untouched skin is read off the presses' free skin, and nothing else is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from device.balls.sphere import Ball
from device.imaging.flat_field import NormalizedImage
from device.inverse_map.model import InverseMap
from host_sync.calibration.slope_models import FREE_RADII, MIN_PRESSES, correct_flat_bias, free_skin_slopes

SHAPE = (180, 240)
NODES = (6, 8)
RAMP = 1e-3 * np.linspace(-1.0, 1.0, SHAPE[1])[None, :, None] * np.array([1.0, -0.5, 0.0])
"""What the reference missed: by columns, red and green."""


@dataclass(frozen=True)
class RedAndGreen:
    """A map for which red less 1 is the slope p and green less 1 the slope q."""

    shape: tuple[int, int] = SHAPE
    noise_bias: np.ndarray | None = None

    def on_grid(self, values: np.ndarray, _column: Any, _row: Any) -> np.ndarray:
        return values[..., :2] - np.float32(1.0)


MAP = cast(InverseMap, RedAndGreen())


def presses(count: int = 6, drift: float = 0.0) -> list[tuple[NormalizedImage, list[Ball]]]:
    """Presses whose skin departs from the reference by the ramp, and by noise; near the ball it is steep."""
    rng = np.random.default_rng(4)
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]]
    known = np.ones(SHAPE, np.bool_)
    found = []
    for number in range(count):
        ball = Ball(SHAPE[1] * (number + 0.5) / count, SHAPE[0] * 0.5, 6.0, 12.0)
        near = np.hypot(column - ball.column, row - ball.row) < 0.99 * FREE_RADII * ball.contact_radius_px
        noise = 2e-3 * rng.standard_normal((*SHAPE, 3)) + drift * rng.standard_normal(3)
        values = np.where(near[..., None], 1.02, 1.0 + RAMP + noise).astype(np.float32)
        found.append((NormalizedImage(values, known, ~known), [ball]))
    return found


def test_what_all_presses_show_is_found() -> None:
    found = free_skin_slopes(MAP, presses(), NODES)
    at_nodes = 1e-3 * np.linspace(-1.0, 1.0, NODES[1])
    np.testing.assert_allclose(found[..., 0].mean(axis=0), at_nodes, atol=1.5e-4)
    np.testing.assert_allclose(found[..., 1].mean(axis=0), -0.5 * at_nodes, atol=1.5e-4)


def test_what_differs_from_press_to_press_is_not_believed() -> None:
    quiet, drifting = (np.abs(free_skin_slopes(MAP, presses(drift=d), NODES)).max() for d in (0.0, 0.01))
    assert drifting < 0.006
    assert quiet < 1.4e-3
    noise_only = free_skin_slopes(MAP, [(image, [Ball(120.0, 90.0, 60.0, 99.0)]) for image, _ in presses()], NODES)
    assert not noise_only.any(), "no skin is far from such a ball"


def test_too_few_presses_show_nothing() -> None:
    assert not free_skin_slopes(MAP, presses(MIN_PRESSES - 1), NODES).any()


def test_a_map_takes_it_off_beside_what_pixel_noise_adds() -> None:
    own = np.full((*NODES, 2), 0.25, np.float32)
    taken = correct_flat_bias(cast(InverseMap, RedAndGreen(noise_bias=own)), presses()).noise_bias
    assert taken is not None
    np.testing.assert_allclose(taken - own, free_skin_slopes(MAP, presses(), NODES), atol=1e-7)
    alone = correct_flat_bias(MAP, presses()).noise_bias
    assert alone is not None
    assert alone.shape == (19, 25, 2)
