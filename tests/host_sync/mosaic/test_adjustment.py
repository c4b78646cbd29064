"""Links of a grid among wrong ones."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from mosaic_presses import errors_px, grid_places

from device.align import Pose
from host_sync.mosaic.adjustment import adjusted
from host_sync.mosaic.links import Link

SHAPE = (272, 364)
REACH_PX = 0.5 * float(np.hypot(*SHAPE))
SIGMA_PX = 0.05
SIGMA_TURN = 3e-4


def link_of(first: int, second: int, pose: Pose, random: np.random.Generator) -> Link:
    """A link as a verified overlap gives it."""
    here = -0.5 * np.array([pose.down, pose.right])
    there = pose.of(here) + random.normal(0.0, SIGMA_PX, 2)
    covariance = np.diag([SIGMA_PX**2, SIGMA_PX**2, SIGMA_TURN**2])
    return Link(first, second, here, there, pose.turn + random.normal(0.0, SIGMA_TURN), covariance, 0.97, 0.3)


def grid_links(truth: list[Pose], columns: int, random: np.random.Generator) -> list[Link]:
    """Links of neighbours beside and below each other."""
    links = []
    for one, other in itertools.combinations(range(len(truth)), 2):
        beside = other == one + 1 and other % columns != 0
        if beside or other == one + columns:
            links.append(link_of(one, other, truth[one].then(truth[other].back()), random))
    return links


@pytest.mark.parametrize("seed", range(5))
def test_fifty_wrong_overlaps_are_rejected(seed: int) -> None:
    random = np.random.default_rng(seed)
    truth = grid_places(5, 5, (190.0, 255.0), random)
    links = grid_links(truth, 5, random)
    good = len(links)
    for _ in range(50):
        one, other = sorted(int(press) for press in random.choice(25, 2, replace=False))
        away = random.uniform(-200.0, 200.0, 2)
        links.append(link_of(one, other, Pose(float(away[0]), float(away[1]), random.normal(0.0, 0.05)), random))
    found = adjusted(links, 25, REACH_PX)
    assert found.used == [True] * good + [False] * 50
    assert errors_px(found.places, truth, 0.0).max() < 1.0
    assert min(found.residual_sigmas[good:]) > 6.0


def test_the_uncertainty_of_a_span_holds_the_errors() -> None:
    random = np.random.default_rng(3)
    ratios = []
    for _ in range(20):
        truth = grid_places(3, 3, (190.0, 255.0), random)
        found = adjusted(grid_links(truth, 3, random), 9, REACH_PX)
        one, other = found.places[0], found.places[8]
        assert one is not None
        assert other is not None
        off = one.distance(other, 0.0) - truth[0].distance(truth[8], 0.0)
        ratios.append(off / found.distance_sigma_px(0, 8))
    # Gels are strained: a floor that these links do not have is part of the uncertainty.
    assert float(np.sqrt(np.mean(np.square(ratios)))) < 1.0


def test_a_press_that_nothing_links_has_no_place() -> None:
    random = np.random.default_rng(3)
    truth = grid_places(1, 3, (190.0, 255.0), random)
    links = [link_of(0, 1, truth[0].then(truth[1].back()), random)]
    found = adjusted(links, 3, REACH_PX)
    assert found.places[2] is None
    assert found.used == [True]
    assert found.loops == [0]
    assert np.isnan(found.distance_sigma_px(0, 2))


def test_of_two_links_of_one_pair_the_one_that_closes_loops_is_kept() -> None:
    random = np.random.default_rng(3)
    truth = grid_places(2, 2, (190.0, 255.0), random)
    links = grid_links(truth, 2, random)
    right = links[0].pose
    links.append(link_of(0, 1, Pose(right.down, right.right + 21.0, right.turn), random))
    found = adjusted(links, 4, REACH_PX)
    assert found.used == [True, True, True, True, False]
