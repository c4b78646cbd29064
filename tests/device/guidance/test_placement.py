"""The way back to an earlier press: right where it is shown, and silent where there is none."""

import sys
from time import process_time

import numpy as np
import pytest

from device.guidance.placement import Placement, Target, Unplaced
from device.surface import HeightMap
from tests.device.guidance.hand_presses import PITCH_MM, Relief


def test_the_way_back_is_in_the_directions_of_the_live_view() -> None:
    """A relief 3 mm to the left of the instrument's middle is reached by moving left."""
    relief = Relief(1)
    found = Target(relief.touch((0.0, 0.0), 0.0, 1)).place(relief.touch((3.0, 2.0), 0.0, 2))
    assert isinstance(found, Placement)
    assert found.right_mm == pytest.approx(-3.0, abs=0.1)
    assert found.down_mm == pytest.approx(-2.0, abs=0.1)
    assert found.clockwise_deg == pytest.approx(0.0, abs=0.8)
    assert found.overlap == pytest.approx((1.0 - 3.0 / 17.5) * (1.0 - 2.0 / 13.0), abs=0.03)


def test_a_turned_instrument_is_turned_back() -> None:
    relief = Relief(2)
    found = Target(relief.touch((0.0, 0.0), 0.0, 1)).place(relief.touch((0.0, 4.0), 10.0, 2))
    assert isinstance(found, Placement)
    assert found.clockwise_deg == pytest.approx(-10.0, abs=0.8)
    # In the turned view, "up on the object" is up and to the left of it by 10 degrees.
    turn = np.radians(-10.0)
    assert found.right_mm == pytest.approx(4.0 * np.sin(turn), abs=0.15)
    assert found.down_mm == pytest.approx(-4.0 * np.cos(turn), abs=0.15)


@pytest.mark.parametrize("reliefs", [8, pytest.param(40, marks=pytest.mark.slow)])
def test_pairs_by_hand_show_no_wrong_way(reliefs: int) -> None:
    """Three pairs of each relief overlap; one lies apart, and one is of different objects."""
    random = np.random.default_rng(26)
    wrong, answered, near, shift_mm, turn_deg = 0, 0, 0, [], []
    for number in range(reliefs):
        relief = Relief(number)
        target = Target(relief.touch((0.0, 0.0), 0.0, number))
        for kind in range(5):
            turn = float(random.uniform(-20.0, 20.0))
            away = random.uniform(-6.0, 6.0, 2) * (1.0, 0.75)
            if kind >= 3:
                away = (np.sign(away) + (away == 0.0)) * (22.0, 22.0)
            relief_now = Relief(1000 + number) if kind == 4 else relief
            found = target.place(relief_now.touch((float(away[0]), float(away[1])), turn, 100 * number + kind))
            near += kind < 3
            if isinstance(found, Unplaced):
                continue
            angle = np.radians(-turn)
            cosine, sine = np.cos(angle), np.sin(angle)
            expected = -away @ np.array([[cosine, sine], [-sine, cosine]])
            off_mm = float(np.hypot(found.right_mm - expected[0], found.down_mm - expected[1]))
            if kind >= 3 or off_mm > 1.0 or abs(found.clockwise_deg + turn) > 4.0:
                wrong += 1
                continue
            answered += 1
            shift_mm.append(off_mm / found.shift_sigma_mm)
            turn_deg.append((found.clockwise_deg + turn) / found.turn_sigma_deg)
    print_figures(f"{wrong} wrong, {answered} of {near} answered; {_rms(shift_mm):.2f} σ, {_rms(turn_deg):.2f} σ")
    assert wrong == 0
    assert answered >= 0.8 * near
    assert _rms(shift_mm) < 1.5
    assert _rms(turn_deg) < 1.5


def test_skin_without_relief_and_a_repeating_relief_are_refused() -> None:
    random = np.random.default_rng(3)
    flat = [HeightMap(random.normal(0.0, 0.5, (130, 175)).astype(np.float32), 100.0) for _ in range(2)]
    found = Target(flat[0]).place(flat[1])
    assert isinstance(found, Unplaced)
    assert "too little relief" in found.reason
    column, row = np.meshgrid(np.arange(175) * PITCH_MM, np.arange(130) * PITCH_MM)
    grid = [
        HeightMap((40.0 * np.cos(2.0 * (column + shift)) * np.cos(2.0 * row)).astype(np.float32), 100.0)
        for shift in (0.0, 0.9)
    ]
    found = Target(grid[0]).place(grid[1])
    assert isinstance(found, Unplaced)
    assert "alike" in found.reason


def test_lines_that_slide_along_themselves_are_refused() -> None:
    column = np.tile(np.arange(175) * PITCH_MM, (130, 1))
    line = [HeightMap((60.0 * np.exp(-((column - at) ** 2))).astype(np.float32), 100.0) for at in (8.0, 9.5)]
    assert isinstance(Target(line[0]).place(line[1]), Unplaced)


def test_a_placement_costs_a_tenth_of_a_second_at_most() -> None:
    relief = Relief(5)
    target, live = Target(relief.touch((0.0, 0.0), 0.0, 1)), relief.touch((2.0, 1.0), 3.0, 2)
    target.place(live)
    began = process_time()
    for _ in range(3):
        target.place(live)
    print_figures(f"{1e3 * (process_time() - began) / 3.0:.0f} ms a placement")
    assert (process_time() - began) / 3.0 < 0.3


def print_figures(line: str) -> None:
    sys.stdout.write(line + "\n")


def _rms(values: list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
