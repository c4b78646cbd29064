"""Frames solved side by side come back in order, each with its own heights, whichever is done first."""

from __future__ import annotations

from collections.abc import Iterator
from threading import Event

import numpy as np
import pytest

from host_sync.errors import IntegrationError
from host_sync.frame_sequence import BadFrame, StoredFrame
from host_sync.reconstruction import frame_crew
from host_sync.reconstruction.frame_crew import FrameCrew
from host_sync.reconstruction.frame_solver import FrameFigures

SHAPE = (4, 6)
PATIENCE_S = 20.0


class Waiting:
    """A solver that writes a frame's value, and holds up the first frame until the second is done."""

    shape = SHAPE

    def __init__(self, second_done: Event, made: list[Waiting]) -> None:
        self._second_done = second_done
        self._made = made
        made.append(self)

    def another(self) -> Waiting:
        return Waiting(self._second_done, self._made)

    def solve(self, frame: StoredFrame, out: np.ndarray) -> FrameFigures:
        value = int(frame.pixels[0, 0, 0])
        if value == 0:
            assert self._second_done.wait(PATIENCE_S)
        if value == 7:
            raise IntegrationError("nothing is valid")
        out.fill(value)
        if value == 1:
            self._second_done.set()
        return FrameFigures(0.0, 0.0, 0.0, float(value))


def frames(*values: int) -> Iterator[StoredFrame]:
    return (StoredFrame(f"frame {value}", np.full((*SHAPE, 3), value, np.uint8)) for value in values)


@pytest.fixture
def two_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if the machine had two cores."""
    monkeypatch.setattr(frame_crew, "get_num_threads", lambda: 2)
    monkeypatch.setattr(frame_crew, "set_num_threads", lambda _count: None)


@pytest.mark.usefixtures("two_threads")
def test_a_frame_that_is_done_first_waits_for_those_before_it() -> None:
    made: list[Waiting] = []
    with FrameCrew(Waiting(Event(), made), spare=1) as crew:
        seen = []
        for outcome, z in crew.solved([*frames(0, 1), BadFrame("torn", "torn: is truncated"), *frames(7, 4, 5)]):
            seen.append((outcome.name, outcome.reason, float(z.min()), float(z.max())))
            crew.give_back(z)
    assert len(made) == 2
    shown = [part for part in seen if part[1] is None]
    assert shown == [(f"frame {value}", None, value, value) for value in (0, 1, 4, 5)]
    assert [part[:2] for part in seen[2:4]] == [
        ("torn", "torn: is truncated"),
        ("frame 7", "frame 7: nothing is valid"),
    ]
    assert np.isnan([part[2] for part in seen[2:4]]).all()


@pytest.mark.usefixtures("two_threads")
def test_names_and_reasons_come_out_fit_for_a_terminal() -> None:
    with FrameCrew(Waiting(Event(), []), spare=2) as crew:
        found = [outcome for outcome, _ in crew.solved([BadFrame("\x1b[2Jtorn", "is\ntorn")])]
    assert [(outcome.name, outcome.reason) for outcome in found] == [("\\x1b[2Jtorn", "\\x1b[2Jtorn: is\\ntorn")]


@pytest.mark.usefixtures("two_threads")
def test_few_frames_are_solved_at_once_where_they_are_large(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(frame_crew, "MOST_PX_AT_ONCE", 30)
    made: list[Waiting] = []
    with FrameCrew(Waiting(Event(), made), spare=0) as crew:
        names = []
        for outcome, z in crew.solved(frames(1, 2, 3)):
            names.append(outcome.name)
            crew.give_back(z)
    assert names == ["frame 1", "frame 2", "frame 3"]
    assert len(made) == 1


@pytest.mark.usefixtures("two_threads")
def test_a_sequence_that_breaks_off_ends_the_crew() -> None:
    def breaking() -> Iterator[StoredFrame]:
        yield from frames(1, 2, 3)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), FrameCrew(Waiting(Event(), []), spare=4) as crew:
        list(crew.solved(breaking()))
