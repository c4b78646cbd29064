"""Frames solved in parallel are returned in order, each with its own heights, whichever is done first."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Future
from threading import Event

import numpy as np
import pytest

from device.errors import CalibrationMismatch
from host_sync.errors import IntegrationError, SourceError
from host_sync.frames.sequence import BadFrame, StoredFrame
from host_sync.video import stream
from host_sync.video.frame_solver import FrameStatistics
from host_sync.video.stream import FrameStream, NewestFrames, in_order

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

    def check(self, _frame: StoredFrame) -> None:
        pass

    def solve(self, frame: StoredFrame, out: np.ndarray, _sigma: None) -> FrameStatistics:
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
    with FrameStream(Waiting(Event(), made), 2) as solving:
        given = [*frames(0, 1), BadFrame("torn", "torn: is truncated"), *frames(7, 4, 5)]
        seen = [
            (one.name, one.reason, float(one.height_um.min()), float(one.height_um.max()))
            for one in solving.solve(given)
        ]
    assert len(made) == 2
    shown = [part for part in seen if part[1] is None]
    assert shown == [(f"frame {value}", None, value, value) for value in (0, 1, 4, 5)]
    assert [part[:2] for part in seen[2:4]] == [
        ("torn", "torn: is truncated"),
        ("frame 7", "frame 7: nothing is valid"),
    ]
    assert np.isnan([part[2] for part in seen[2:4]]).all()


def test_names_and_reasons_come_out_fit_for_a_terminal() -> None:
    with FrameStream(Waiting(Event(), []), 2) as solving:
        found = list(solving.solve([BadFrame("\x1b[2Jtorn", "is\ntorn")]))
    assert [(one.name, one.reason) for one in found] == [("\\x1b[2Jtorn", "\\x1b[2Jtorn: is\\ntorn")]


def test_few_frames_are_solved_at_once_where_they_are_large(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[Waiting] = []
    monkeypatch.setattr(stream, "MAX_PX_AT_ONCE", 30)
    monkeypatch.setattr(stream, "get_num_threads", lambda: 2)
    with FrameStream(Waiting(Event(), made)) as solving:
        names = [one.name for one in solving.solve(frames(1, 2, 3))]
    assert names == ["frame 1", "frame 2", "frame 3"]
    assert len(made) == 1


def test_a_sequence_that_breaks_off_ends_the_crew() -> None:
    def breaking() -> Iterator[StoredFrame]:
        yield from frames(1, 2, 3)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), FrameStream(Waiting(Event(), []), 2) as solving:
        list(solving.solve(breaking()))


def test_a_stream_that_is_closed_gives_no_further_frame() -> None:
    with FrameStream(Waiting(Event(), []), 1) as solving:
        found = solving.solve(frames(1, 2, 3))
        assert next(found).name == "frame 1"
        solving.close()
        assert list(found) == []
    done, cancelled = Future[int](), Future[int]()
    done.set_result(5)
    assert cancelled.cancel()
    assert list(in_order([done, cancelled, done], 1)) == [5]


def test_the_newest_frame_is_solved_and_older_ones_are_counted() -> None:
    """The source gives three frames while the first is solved, and ends when the last of them was taken."""
    taken, given = Event(), Event()

    def source() -> Iterator[StoredFrame]:
        every = [StoredFrame(one.name, one.pixels, number) for number, one in enumerate(frames(1, 2, 3, 4))]
        yield every[0]
        assert taken.wait(PATIENCE_S)
        yield from every[1:]
        given.set()

    newest = NewestFrames(source())
    numbers = []
    with FrameStream(Waiting(Event(), []), 1) as solving:
        for one in solving.solve(newest):
            numbers.append(one.number)
            taken.set()
            assert given.wait(PATIENCE_S)
    newest.close()
    assert numbers == [0, 3]
    assert newest.dropped == 2


def test_the_newest_frames_end_when_they_are_closed() -> None:
    newest = NewestFrames(frames(1, 2))
    with newest._changed:
        assert newest._changed.wait_for(lambda: newest._ended, PATIENCE_S)
    newest.close()
    assert list(newest) == []


def test_a_source_that_fails_ends_the_newest_frames_with_its_error() -> None:
    def source() -> Iterator[StoredFrame]:
        yield from frames(1)
        raise SourceError("camera 0 gives no picture")

    newest = NewestFrames(source())
    with pytest.raises(SourceError, match="camera 0"):
        list(newest)
    newest.close()


@pytest.mark.parametrize("at_once", [1, 2])
def test_few_frames_are_checked_and_all_after_one_that_does_not_pass(
    at_once: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stream, "CHECK_INTERVAL", 3)
    checked: list[int] = []

    class Checking(Waiting):
        def clone(self) -> Waiting:
            return Checking(self._second_done, self._made)

        def check(self, frame: StoredFrame) -> None:
            value = int(frame.pixels[0, 0, 0])
            checked.append(value)
            if value in {8, 9}:
                raise CalibrationMismatch("another gel")

        def solve(self, _frame: StoredFrame, _out: np.ndarray, _sigma: None) -> FrameStatistics:
            return FrameStatistics(0.0, 0.0, 0.0, 0.0)

    with FrameStream(Checking(Event(), []), at_once) as solving:
        given = [*frames(1, 2, 3), BadFrame("torn", "torn: is truncated"), *frames(5, 6, 8, 9, 4)]
        reasons = [one.reason for one in solving.solve(given)]
    assert sorted(checked) == [1, 4, 5, 6, 8, 9]
    refused = ["frame 8: another gel", "frame 9: another gel"]
    assert reasons == [None, None, None, "torn: is truncated", None, None, *refused, None]
