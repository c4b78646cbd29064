"""Kernels of steps under lamps, against the same formulas over whole arrays."""

from __future__ import annotations

import numpy as np
import pytest

from host_sync.lights.step_kernel import write_shown, write_step

PLACES = 9
BAND = slice(2, 7)
"""Rows that are written; the others stay as they are."""


@pytest.mark.parametrize("slopes", [1, 3])
def test_skin_shows_mixed_light_over_that_of_rest_and_what_skin_around_it_sends(slopes: int) -> None:
    random = np.random.default_rng(slopes)
    own, shown = random.uniform(0.2, 1.5, (PLACES, slopes, 3)), np.full((PLACES, slopes, 3), np.nan)
    mixing, haze, bounce = random.uniform(0.0, 1.0, (3, 3)), random.uniform(0.0, 0.1, 3), np.array([0.1, 0.25])
    rest, close = random.uniform(0.5, 2.0, (2, PLACES, 3))
    p, q = random.normal(0.0, 0.4, (2, PLACES, slopes))
    write_shown(own, mixing, haze, rest, close, bounce, p, q, shown, BAND.start, BAND.stop)
    mixed = np.einsum("cl,nkl->nkc", mixing, own) + haze
    tilted = 1.0 - np.cos(np.arctan(np.hypot(p, q)))
    around = tilted[..., None] * (bounce[0] + bounce[1] * close[:, None])
    wanted = np.full_like(shown, np.nan)
    wanted[BAND] = (mixed / rest[:, None] + around)[BAND]
    np.testing.assert_allclose(shown, wanted, rtol=1e-12)


def test_a_step_solves_the_normal_equations_of_each_place() -> None:
    random = np.random.default_rng(0)
    change, missing = random.normal(size=(PLACES, 3, 2)), random.normal(size=(PLACES, 3))
    weight, back, known = random.uniform(0.0, 5.0, (PLACES, 3)), random.normal(size=(PLACES, 2)), 0.7
    weight[4] = 0.0
    step = np.full((PLACES, 2), np.nan)
    write_step(change, weight, missing, back, known, step, BAND.start, BAND.stop)
    wanted = np.full_like(step, np.nan)
    for place in range(BAND.start, BAND.stop):
        weighted = change[place].T * weight[place]
        right = weighted @ missing[place] + known * back[place]
        wanted[place] = np.linalg.solve(weighted @ change[place] + known * np.eye(2), right)
    np.testing.assert_allclose(step, wanted, rtol=1e-10)
    np.testing.assert_allclose(step[4], back[4], rtol=1e-12, err_msg="no channel counts")
