"""Lattices with balls missing, false, turned, in perspective and bent: every ball must get its own place."""

from __future__ import annotations

import numpy as np
import pytest

from host_sync.calibration.lattice import find_lattice

STEP_PX = 100.0
SHAPE = (8, 7)


def places() -> np.ndarray:
    across, down = np.meshgrid(np.arange(SHAPE[0]), np.arange(SHAPE[1]))
    return np.stack([across, down], axis=-1).reshape(-1, 2) - np.array([3.0, 3.0])


def seen(turn: float, tilt: float = 0.0, bend: float = 0.0) -> np.ndarray:
    """Where the balls are seen, in pixels."""
    matrix = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    flat = places() @ matrix.T / (1.0 + places() @ [tilt, -0.5 * tilt])[:, None]
    return 600.0 + STEP_PX * flat * (1.0 + bend * (flat**2).sum(axis=1, keepdims=True))


@pytest.mark.parametrize("turn", [0.0, 0.4, 0.8, 2.5])
@pytest.mark.parametrize(
    ("missing", "false", "tilt", "bend"),
    [(0.0, 0.0, 0.0, 0.0), (0.4, 0.0, 0.0, 0.0), (0.2, 0.25, 0.0, 0.0), (0.1, 0.1, 0.08, 0.0), (0.1, 0.1, 0.03, 0.004)],
)
def test_every_ball_gets_its_place(turn: float, missing: float, false: float, tilt: float, bend: float) -> None:
    random = np.random.default_rng(round(100 * (turn + missing + tilt)))
    points = seen(turn, tilt, bend) + random.normal(0.0, 0.01 * STEP_PX, (len(places()), 2))
    there = random.uniform(size=len(points)) >= missing
    strays = random.uniform(points.min(axis=0), points.max(axis=0), (round(false * len(points)), 2))
    lattice = find_lattice(np.concatenate([points[there], strays]))
    assert lattice is not None
    real = np.arange(len(lattice.on)) < there.sum()
    assert lattice.on[real].mean() > 0.9
    both = lattice.on & real
    # The lattice may be turned by quarters and counted from another ball: an isometry of whole numbers.
    design = np.concatenate([places()[there], np.ones((there.sum(), 1))], axis=1)[both[: there.sum()]]
    turned, _, _, _ = np.linalg.lstsq(design, lattice.index[both].astype(float), rcond=None)
    assert np.abs(design @ turned - lattice.index[both]).max() < 1e-6
    assert abs(np.linalg.det(turned[:2])) == pytest.approx(1.0)


def test_axes_follow_the_frame() -> None:
    lattice = find_lattice(seen(0.1))
    assert lattice is not None
    across, down = lattice.pixels(np.array([[1, 0], [0, 1]])) - lattice.pixels(np.array([[0, 0]]))
    assert across[0] > 0.9 * STEP_PX
    assert down[1] > 0.9 * STEP_PX
    assert lattice.step_px(np.zeros(2)) == pytest.approx(STEP_PX)


def test_a_ball_off_the_lattice_is_reported_and_its_empty_place_too() -> None:
    points = seen(0.2)
    points[20] += [0.35 * STEP_PX, 0.0]
    lattice = find_lattice(points)
    assert lattice is not None
    assert np.flatnonzero(~lattice.on).tolist() == [20]
    empty = lattice.pixels(lattice.missing())
    assert np.hypot(*(empty - seen(0.2)[20]).T).min() < 0.01 * STEP_PX


def test_balls_anywhere_form_no_lattice() -> None:
    random = np.random.default_rng(3)
    found = [find_lattice(random.uniform(0.0, 1000.0, (12, 2))) for _ in range(10)]
    assert found == [None] * 10
    assert find_lattice(seen(0.0)[:4]) is None
    assert find_lattice(seen(0.0)[:8]) is None  # one row holds up no plane
