"""Registration of presses that differ as presses do: accepted to half a pixel, or refused with the reason."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

import numpy as np
import pytest
from press_pairs import OBJECTS, PressPair, Prism, depth_pairs, hand_pairs

from device.align import Pose
from hal.simulator.surfaces import Block, Groove
from host_sync.registration.fit import Pair, middle_px, reduced
from host_sync.registration.register import COARSE_PX, Registration, register

ENOUGH_PX = 0.5
SLIDING = ("prism", "long groove")


def error_px(pair: PressPair, found: Registration) -> float:
    """Distance between found and true place of the object's middle, px."""
    middle = middle_px(Pair.of(pair.first.z_um, pair.second.z_um, COARSE_PX))
    return found.pose.distance_at(pair.truth, middle)


def tally(pairs: Iterable[PressPair]) -> Counter[tuple[str, str]]:
    """Accepted, wrong and refused pairs by object; every wrong one is printed."""
    found: Counter[tuple[str, str]] = Counter()
    for pair in pairs:
        registration = register(pair.first, pair.second)
        error = error_px(pair, registration)
        outcome = "refused" if not registration.accepted else "accepted" if error <= ENOUGH_PX else "wrong"
        found[pair.name, outcome] += 1
        if outcome == "wrong":
            print(f"{pair.name}: {error:.2f} px off, {registration}")  # noqa: T201
    return found


def total(found: Counter[tuple[str, str]], outcome: str, names: Iterable[str] = OBJECTS) -> int:
    return sum(found[name, outcome] for name in names)


@pytest.mark.slow
def test_no_hand_like_shift_is_wrongly_accepted() -> None:
    found = tally(hand_pairs(10, seed=7))
    assert total(found, "wrong") == 0
    assert total(found, "accepted", SLIDING) == 0
    assert total(found, "accepted") >= 5


@pytest.mark.slow
def test_two_hundred_hand_like_shifts() -> None:
    found = tally(hand_pairs(200, seed=2))
    for name in OBJECTS:
        print(name, {outcome: found[name, outcome] for outcome in ("accepted", "wrong", "refused")})  # noqa: T201
    print({outcome: total(found, outcome) for outcome in ("accepted", "wrong", "refused")})  # noqa: T201
    assert total(found, "wrong") == 0
    assert total(found, "accepted", SLIDING) == 0
    assert total(found, "accepted") >= 100


@pytest.mark.parametrize(
    ("kind", "slide_mm"),
    [
        *(
            pytest.param(kind, 0.4, marks=pytest.mark.slow)
            for kind in ("prism", "groove", "short prism", "scratched prism")
        ),
        *(
            pytest.param(kind, 0.0, marks=pytest.mark.slow)
            for kind in ("prism", "groove", "short prism", "scratched prism")
        ),
    ],
)
def test_a_prism_at_four_depths_is_found_or_refused(kind: str, slide_mm: float) -> None:
    surface = {
        "prism": Prism(30.0),
        "groove": Groove(Block(30.0, 30.0), 0.8, 0.2, 0.12),
        "short prism": Prism(2.5),
        "scratched prism": Prism(30.0, 0.02),
    }[kind]
    outcomes = []
    for pair in depth_pairs(surface, slide_mm, seed=3):
        registration = register(pair.first, pair.second)
        assert not registration.accepted or error_px(pair, registration) <= ENOUGH_PX, pair.name
        outcomes.append(registration.accepted)
    assert len(outcomes) == 6
    assert kind == "scratched prism" or not any(outcomes)


def test_texture_of_the_frames_is_one_more_start() -> None:
    pair = next(hand_pairs(1, seed=11))
    generator = np.random.default_rng(4)
    grain = 1.0 + 0.05 * generator.standard_normal(pair.first.z_um.shape).astype(np.float32)
    found = register(pair.first, pair.second, frames=(grain, np.roll(grain, (5, -8), (0, 1))))
    # What is fixed to the gel may start a fit, and decides nothing.
    assert not found.accepted or error_px(pair, found) <= ENOUGH_PX


def test_a_person_may_nudge_and_pin() -> None:
    pairs = {pair.name: pair for pair in hand_pairs(10, seed=7)}
    coin = pairs["coin"]
    off = Pose(coin.truth.down + 3.0, coin.truth.right - 2.0, coin.truth.turn)
    nudged = register(coin.first, coin.second, near=off)
    assert nudged.by == "nudged"
    assert nudged.accepted
    assert error_px(coin, nudged) < ENOUGH_PX
    pinned = register(coin.first, coin.second, near=off, pinned=True)
    assert pinned.pose == off
    assert pinned.by == "pinned"
    sliding = register(pairs["prism"].first, pairs["prism"].second, near=pairs["prism"].truth, pinned=True)
    assert sliding.accepted


def test_squares_with_single_invalid_pixels_have_a_height() -> None:
    z_um = np.tile(np.float32(3.0), (9, 8))
    z_um[0, 0] = np.nan
    z_um[4:6, 4:6] = np.nan
    means = reduced(z_um, 2)
    assert means.shape == (4, 4)
    assert np.isnan(means[2, 2])
    assert np.isnan(means).sum() == 1
    assert means[0, 0] == pytest.approx(3.0)
