"""The way back in words: directions of the live view, and no direction where the place is unknown."""

from dataclasses import replace

import pytest

from device.guidance.placement import Placement, Unplaced, on_the_spot, sentence

THERE = Placement(0.1, -0.05, 0.3, 0.05, 0.4, 0.98, 80.0)


@pytest.mark.parametrize(
    ("found", "said"),
    [
        (
            replace(THERE, right_mm=-8.0, clockwise_deg=10.0),
            "Move 8.0 mm left, then turn 10° clockwise (±0.1 mm, ±1°).",
        ),
        (replace(THERE, right_mm=6.0, down_mm=2.0), "Move 6.0 mm right and 2.0 mm down (±0.1 mm, ±1°)."),
        (replace(THERE, clockwise_deg=-5.0, right_mm=0.0), "Turn 5° anticlockwise (±0.1 mm, ±1°)."),
        (THERE, "On the spot (±0.1 mm, ±1°)."),
        (Unplaced("not recognised"), "Place unknown: not recognised."),
    ],
)
def test_the_sentence_says_what_the_hand_does(found: Placement | Unplaced, said: str) -> None:
    assert sentence(found) == said


def test_only_a_known_place_is_the_spot() -> None:
    assert on_the_spot(THERE)
    assert not on_the_spot(replace(THERE, right_mm=0.31))
    assert not on_the_spot(replace(THERE, clockwise_deg=2.0))
    assert not on_the_spot(Unplaced("not recognised"))
