"""The live view: who may listen, what a picture holds, and the page that draws it in a real browser."""

from __future__ import annotations

import json
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from drawn_frames import settle
from limits import join
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from host_sync.frames.sequence import StoredFrame
from host_sync.video.frame_solver import FrameStatistics
from host_sync.video.sensors import Recorder
from host_sync.video.stream import SolvedFrame
from host_sync.viewer.access import Access
from host_sync.viewer.app import make_live_app
from host_sync.viewer.cache import level_count, padded_shape
from host_sync.viewer.live import LiveView
from host_sync.viewer.serving import listening, make_server

SHAPE = (120, 160)
PITCH_UM = 50.0


def bump_um(column: float) -> np.ndarray:
    row, columns = np.mgrid[: SHAPE[0], : SHAPE[1]]
    return (400.0 * np.exp(-((row - 60.0) ** 2 + (columns - column) ** 2) / 15.0**2)).astype(np.float32)


class Source:
    """Solved frames as a test lets them go."""

    def __init__(self) -> None:
        self.problem: str | None = None
        self.has_sigma = True
        self.dropped, self.read = 3, 10
        self._given: list[SolvedFrame | None] = []
        self._changed = threading.Condition()

    def give(self, number: int, column: float, *, relative: bool = False) -> None:
        figures = FrameStatistics(0.1, 0.0, 0.0, 400.0, relative)
        frame = StoredFrame("X", np.zeros((*SHAPE, 3), np.uint8), number, time.monotonic_ns())
        sigma_um = np.full(SHAPE, 6.0, np.float32)
        with self._changed:
            self._given.append(SolvedFrame(number, "X", bump_um(column), sigma_um, figures, frame))
            self._changed.notify_all()

    def close(self) -> None:
        with self._changed:
            self._given.append(None)
            self._changed.notify_all()

    def time_s(self, solved: SolvedFrame) -> float:
        return 0.04 * solved.number

    def __iter__(self) -> Iterator[SolvedFrame]:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._given)
                one = self._given.pop(0)
            if one is None:
                return
            yield one


class Solver:
    shape, pitch_um = SHAPE, PITCH_UM


class ServedLive:
    """A live view that answers."""

    def __init__(self, access: Access, source: Source, recordings: Path) -> None:
        self.access, self.source, self.recordings = access, source, recordings

    @property
    def origin(self) -> str:
        return self.access.origin

    def listen(self, cookie: bool = True, origin: str | None = None, host: str | None = None) -> Any:
        headers = {"Cookie": f"{self.access.cookie}={self.access.token}"} if cookie else {}
        named = host or self.origin.removeprefix("http://")
        own = socket.create_connection(("127.0.0.1", self.access.port))
        address = f"ws://{named}/api/live/pictures"
        return connect(address, sock=own, proxy=None, origin=origin or self.origin, additional_headers=headers)


@pytest.fixture
def live(tmp_path: Path) -> Iterator[ServedLive]:
    source, recordings = Source(), tmp_path / "recordings"
    view = LiveView("gel-7", source, Recorder(recordings), Solver())
    with listening("127.0.0.1", 0) as listeners:
        access = Access("127.0.0.1", listeners[0].getsockname()[1])
        server = make_server(make_live_app(view, access))
        thread = threading.Thread(target=server.run, kwargs={"sockets": listeners})
        thread.start()
        view.start()
        yield ServedLive(access, source, recordings)
        view.close()
        server.should_exit = True
        join(thread)


def message(page: Any) -> tuple[dict[str, Any], bytes]:
    data = page.recv(timeout=20.0)
    (length,) = struct.unpack_from("<I", data)
    return json.loads(data[4 : 4 + length]), data[4 + length :]


@pytest.mark.parametrize("wrong", [{"cookie": False}, {"origin": "http://example.org"}, {"host": "localhost:1"}])
def test_only_the_own_page_listens(live: ServedLive, wrong: dict[str, Any]) -> None:
    with pytest.raises(InvalidStatus, match="403"):
        live.listen(**wrong)


def test_a_picture_holds_the_surface_and_what_touches_it(live: ServedLive) -> None:
    live.source.give(0, 80.0)
    with live.listen() as page:
        header, body = message(page)
    rows, columns = padded_shape(SHAPE)
    surface = np.frombuffer(body, np.float16, 4 * rows * columns).reshape(rows, columns, 4).astype(np.float32)
    np.testing.assert_allclose((surface[..., 2] + surface[..., 3])[:120, :160], bump_um(80.0), atol=0.01)
    assert len(body) >= rows * columns * 9
    assert level_count(SHAPE) == 2
    assert header["depth_um"] == pytest.approx(400.0, rel=0.02)
    assert header["depth_sigma_um"] == 6.0
    assert header["centre"] == pytest.approx([60.0, 80.0], abs=0.5)
    assert (header["dropped"], header["read"], header["relative"], header["lost"]) == (3, 10, False, None)


def test_few_pictures_are_on_their_way_and_the_newest_is_next(live: ServedLive) -> None:
    with live.listen() as page:
        for number in (0, 1):
            live.source.give(number, 80.0)
            assert message(page)[0]["number"] == number
        for number in (2, 3, 4):
            live.source.give(number, 80.0)
        with pytest.raises(TimeoutError):
            page.recv(timeout=0.5)
        page.send(json.dumps({"drawn": 0}))
        header, _ = message(page)
        assert header["number"] == 4
        assert header["age_ms"] > 0.0


def test_a_lost_sensor_is_said_without_a_picture(live: ServedLive) -> None:
    live.source.problem = "camera X does not answer: plug it in again"
    with live.listen() as page:
        header, body = message(page)
    assert header["lost"] == live.source.problem
    assert "number" not in header
    assert body == b""


def test_the_page_draws_what_comes_and_records(live: ServedLive, visit: Callable[..., Any]) -> None:
    page = visit(live)
    live.source.give(0, 40.0)
    page.wait_for_selector(".stage[data-ready]")
    page.wait_for_selector("dd:has-text('column 40.0')")
    assert page.url.endswith("#/live")
    assert page.title() == "gel-7, live – Retrograph"
    before = page.locator(".surface").screenshot()
    live.source.give(1, 120.0)
    page.wait_for_selector("dd:has-text('column 120.0')")
    assert 396.0 < float(page.inner_text("dl.live dd").split()[0]) < 401.0
    settle(page)
    assert page.locator(".surface").screenshot() != before
    page.mouse.move(100, 100)
    page.keyboard.press("3")  # turned while it moves
    live.source.give(2, 100.0, relative=True)
    page.wait_for_selector(".problem:has-text('No untouched skin')")
    page.keyboard.press("r")
    page.wait_for_selector("button[aria-pressed=true]:text-is('Stop')")
    assert list(live.recordings.iterdir())
    page.keyboard.press("r")
    page.wait_for_selector("button:text-is('Record')")
