"""Frames solved in parallel are returned in order, each with its own heights, whichever is done first."""

from __future__ import annotations

from collections.abc import Iterator
from threading import Event

import numpy as np
import pytest

from host_sync.errors import IntegrationError
from host_sync.frames.sequence import BadFrame, StoredFrame
from host_sync.video.frame_solver import FrameStatistics
from host_sync.video.pool import SolverPool

SHAPE = (4, 6)
PATIENCE_S = 20.0


class Waiting:
    """A solver that writes a frame's value, and holds up the first frame until the second is done."""

    shape = SHAPE

    def __init__(self, second_done: Event, made: list[Waiting]) -> None:
        self._second_done = second_done
        self._made = made
        made.append(self)

    def clone(self) -> Waiting:
        return Waiting(self._second_done, self._made)

    def solve(self, frame: StoredFrame, out: np.ndarray) -> FrameStatistics:
        value = int(frame.pixels[0, 0, 0])
        if value == 0:
            assert self._second_done.wait(PATIENCE_S)
        if value == 7:
            raise IntegrationError("nothing is valid")
        out.fill(value)
        if value == 1:
            self._second_done.set()
        return FrameStatistics(0.0, 0.0, 0.0, float(value))


def frames(*values: int) -> Iterator[StoredFrame]:
    return (StoredFrame(f"frame {value}", np.full((*SHAPE, 3), value, np.uint8)) for value in values)


def test_a_frame_that_is_done_first_waits_for_those_before_it() -> None:
    made: list[Waiting] = []
    with SolverPool(Waiting(Event(), made), spare=1, threads=2) as pool:
        seen = []
        for outcome, z in pool.map([*frames(0, 1), BadFrame("torn", "torn: is truncated"), *frames(7, 4, 5)]):
            seen.append((outcome.name, outcome.reason, float(z.min()), float(z.max())))
            pool.release(z)
    assert len(made) == 2
    shown = [part for part in seen if part[1] is None]
    assert shown == [(f"frame {value}", None, value, value) for value in (0, 1, 4, 5)]
    assert [part[:2] for part in seen[2:4]] == [
        ("torn", "torn: is truncated"),
        ("frame 7", "frame 7: nothing is valid"),
    ]
    assert np.isnan([part[2] for part in seen[2:4]]).all()


def test_names_and_reasons_come_out_fit_for_a_terminal() -> None:
    with SolverPool(Waiting(Event(), []), spare=2, threads=2) as pool:
        found = [outcome for outcome, _ in pool.map([BadFrame("\x1b[2Jtorn", "is\ntorn")])]
    assert [(outcome.name, outcome.reason) for outcome in found] == [("\\x1b[2Jtorn", "\\x1b[2Jtorn: is\\ntorn")]


def test_few_frames_are_solved_at_once_where_they_are_large() -> None:
    made: list[Waiting] = []
    with SolverPool(Waiting(Event(), made), spare=0, threads=2, max_px_at_once=30) as pool:
        names = []
        for outcome, z in pool.map(frames(1, 2, 3)):
            names.append(outcome.name)
            pool.release(z)
    assert names == ["frame 1", "frame 2", "frame 3"]
    assert len(made) == 1


def test_a_sequence_that_breaks_off_ends_the_crew() -> None:
    def breaking() -> Iterator[StoredFrame]:
        yield from frames(1, 2, 3)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), SolverPool(Waiting(Event(), []), spare=4, threads=2) as pool:
        list(pool.map(breaking()))
