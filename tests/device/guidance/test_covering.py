"""Covering an area by hand: presses of a simulated relief where the guide sends the hand, missed by a millimetre."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from device.guidance.cover_task import Covering, InstrumentPose
from device.guidance.placement import Unplaced
from tests.device.guidance.hand_presses import Relief

AREA_MM = (38.0, 30.0)


def walked(seed: int, miss_mm: float, turn_deg: float) -> tuple[Covering, list[float], int]:
    """The area as a hand covers it, the errors of where the guide believed it to stand (mm), and presses in all."""
    random = np.random.default_rng([seed, 9])
    relief, at, turn, off, presses = Relief(seed), np.array([-10.0, -9.0]), 0.0, [], 1
    start = at.copy()
    covering = Covering(*AREA_MM, relief.touch((float(at[0]), float(at[1])), 0.0, 100 * seed))
    while (place := covering.next_place()) is not None and presses < 30:
        way = covering.poses[-1].way_to(place)
        cosine, sine = np.cos(np.radians(turn)), np.sin(np.radians(turn))
        step = np.array([cosine * way[0] - sine * way[1], sine * way[0] + cosine * way[1]])
        at = at + step + random.normal(0.0, miss_mm, 2)
        turn = float(random.normal(0.0, turn_deg))
        found = covering.add(relief.touch((float(at[0]), float(at[1])), turn, 100 * seed + presses))
        presses += 1
        if isinstance(found, Unplaced):
            # The hand goes back to where it was known to be.
            last = covering.poses[-1]
            at, turn = start + np.array([last.right_mm, last.down_mm]), last.clockwise_deg
            continue
        off.append(float(np.hypot(*(at - start - (found.right_mm, found.down_mm)))))
    return covering, off, presses


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_an_area_is_covered_by_presses_that_overlap(seed: int) -> None:
    covering, off, presses = walked(seed, 0.7, 2.0)
    overlaps = [pose.overlap for pose in covering.poses[1:]]
    sys.stdout.write(f"{presses} presses, {covering.share:.3f} covered, overlap {min(overlaps):.2f} at least, ")
    sys.stdout.write(f"{max(off):.2f} mm off at most\n")
    assert covering.share > 0.98
    assert min(overlaps) >= 0.25
    assert max(off) < 1.0
    assert presses <= 16


def test_a_press_of_another_object_covers_nothing() -> None:
    covering = Covering(*AREA_MM, Relief(1).touch((0.0, 0.0), 0.0, 1))
    before = covering.share
    assert isinstance(covering.add(Relief(77).touch((3.0, 0.0), 0.0, 2)), Unplaced)
    assert covering.share == before
    assert len(covering.poses) == 1


def test_an_area_within_the_field_is_covered_by_the_first_press() -> None:
    covering = Covering(5.0, 5.0, Relief(1).touch((0.0, 0.0), 0.0, 1))
    assert covering.share == 1.0
    assert covering.next_place() is None


def test_the_way_is_in_the_directions_of_the_live_view() -> None:
    right, down = InstrumentPose(1.0, 2.0, 90.0, 1.0).way_to((4.0, 2.0))
    assert (right, down) == pytest.approx((0.0, -3.0))
