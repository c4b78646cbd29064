"""The live picture's pace: as asked while the terminal keeps up, slower when it does not, and back again."""

import pytest

from device.tui.drawing.height_picture import MAX_INTERVAL_S, FrameRateLimiter


def test_pictures_come_at_the_interval() -> None:
    pace = FrameRateLimiter(0.1)
    assert [pace.is_due(now_s) for now_s in (0.0, 0.05, 0.1, 0.15, 0.2)] == [True, False, True, False, True]


def test_a_slow_terminal_gets_fewer_pictures_down_to_a_floor() -> None:
    pace = FrameRateLimiter(0.1)
    for _ in range(3):
        pace.tick(late_s=1.0)
    assert pace.interval_s == pytest.approx(0.8)
    for _ in range(9):
        pace.tick(late_s=60.0)
    assert pace.interval_s == MAX_INTERVAL_S


def test_after_a_calm_while_the_pace_quickens_again() -> None:
    pace = FrameRateLimiter(0.1)
    pace.tick(late_s=1.0)
    for _ in range(20):
        pace.tick(late_s=0.0)
    assert pace.interval_s == pytest.approx(0.1)
    for _ in range(100):
        pace.tick(late_s=0.0)
    assert pace.interval_s == pytest.approx(0.1)
