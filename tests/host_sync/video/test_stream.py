"""Frames solved in parallel are returned in order, each with its own heights, whichever is done first."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Future
from threading import Event

import numpy as np
import pytest

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

    def light_of(self, _frame: StoredFrame) -> None:
        return None

    def solve(self, frame: StoredFrame, out: np.ndarray, _light: None, _sigma: None) -> FrameStatistics:
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
def test_frames_of_a_stretch_share_the_light_of_its_first_frame(at_once: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stream, "STRETCH", 3)
    shared: list[tuple[int, object]] = []

    class Lit(Waiting):
        def clone(self) -> Waiting:
            return Lit(self._second_done, self._made)

        def light_of(self, frame: StoredFrame) -> int:
            return int(frame.pixels[0, 0, 0])

        def solve(self, frame: StoredFrame, _out: np.ndarray, light: object, _sigma: None) -> FrameStatistics:
            shared.append((int(frame.pixels[0, 0, 0]), light))
            return FrameStatistics(0.0, 0.0, 0.0, 0.0)

    with FrameStream(Lit(Event(), []), at_once) as solving:
        list(solving.solve([*frames(1, 2, 3), BadFrame("torn", "is torn"), *frames(5, 6)]))
    # A stretch whose first frame cannot be used has the light of each of its frames.
    assert sorted(shared) == [(1, 1), (2, 1), (3, 1), (5, None), (6, None)]
