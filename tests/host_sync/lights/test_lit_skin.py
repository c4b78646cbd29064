"""Skin that every lamp reaches, by its slope and place."""

from __future__ import annotations

import numpy as np
from point_lamps import POSITION, point_lamps

from host_sync.lights.lit_skin import GRAZED, is_lit_by_all

SHAPE = (300, 400)
MODEL = point_lamps(SHAPE)
ROW, COLUMN = (part.ravel().astype(np.float64) for part in np.mgrid[0:300:20, 0:400:20])
MIDDLE = np.array([0.5 * (SHAPE[1] - 1)]), np.array([0.5 * (SHAPE[0] - 1)])
FIRST = POSITION[0]
AWAY = FIRST[:2] / np.hypot(*FIRST[:2])
LEVEL = FIRST[2] / np.hypot(*FIRST[:2])


def lit_at_middle(slope: float) -> bool:
    """Whether skin in the middle is lit that rises towards the first lamp by so much."""
    p, q = (np.array([slope * part]) for part in AWAY)
    return bool(is_lit_by_all(MODEL, p, q, *MIDDLE)[0])


def test_level_skin_is_lit_everywhere_however_low_the_lamps_stand() -> None:
    level = np.zeros_like(ROW)
    assert is_lit_by_all(MODEL, level, level, COLUMN, ROW).all()
    low = point_lamps(SHAPE, POSITION * [1.0, 1.0, 0.2])
    assert is_lit_by_all(low, level, level, COLUMN, ROW).all()


def test_skin_that_rises_towards_a_lamp_hides_it_from_itself() -> None:
    limit = LEVEL - GRAZED
    assert lit_at_middle(limit - 0.01)
    assert not lit_at_middle(limit + 0.01)


def test_far_from_a_lamp_less_slope_hides_it() -> None:
    far, near = (int(edge) for edge in (COLUMN.argmin(), COLUMN.argmax()))
    slope = np.full(1, LEVEL - GRAZED - 0.05)
    lit = [is_lit_by_all(MODEL, slope, 0.0 * slope, COLUMN[[at]], ROW[[at]])[0] for at in (far, near)]
    assert lit == [False, True]
