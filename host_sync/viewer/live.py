"""A live view: heights of a running source for pages that are open, through a web socket.

A message to the page is the length of a JSON header (four bytes, little endian), the header, and for each level of the
surface half floats and validity bytes, as `cache` describes. The page answers with the number of each picture that it
has drawn, so that at most `AHEAD` pictures are on their way, the newest one is sent, and its age is measured to the
drawn picture.
"""

from __future__ import annotations

import asyncio
import struct
import time
from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from threading import Condition, Thread
from typing import Any, Final

import cv2
import msgspec
import numpy as np
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import BaseRoute, Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from device.errors import DeviceError
from device.surface import Float32Array, HeightMap
from hal.errors import HalError
from host_sync.errors import HostError
from host_sync.render.shading import steep_slope
from host_sync.video.contact import find_contact
from host_sync.video.frame_solver import FrameSolver
from host_sync.video.sensors import Recorder
from host_sync.video.stream import LiveHeights, SolvedFrame
from host_sync.viewer.cache import coarse_levels, finest_rows, level_count, padded_shape
from host_sync.viewer.responses import json_answer, readable

AHEAD: Final = 2
"""Pictures on their way to a page."""

WIDEST_PX: Final = 640
"""Columns of a surface that is sent, at most."""

RATE_OVER_S: Final = 2.0
"""Time over which rates are counted."""


@dataclass(frozen=True, slots=True)
class _Picture:
    """A message to a page, and the frame that it shows."""

    number: int
    taken_ns: int
    header: dict[str, Any]
    body: bytes


class LiveView:
    """Solves a source in a thread and gives the newest picture to every page.

    Parameters
    ----------
    name : of the source
    live : its heights
    recorder : writes the frames that come while a page asks for it
    solver : of its frames
    doubts : reasons to distrust all heights
    """

    def __init__(
        self, name: str, live: LiveHeights, recorder: Recorder, solver: FrameSolver, doubts: tuple[str, ...] = ()
    ) -> None:
        shape, pitch_um = solver.shape, solver.pitch_um
        self._name, self._live, self._recorder, self._doubts = name, live, recorder, doubts
        self._step = -(-shape[1] // WIDEST_PX)
        self._shape = (-(-shape[0] // self._step), -(-shape[1] // self._step))
        self._pitch_um, self._full_pitch_um = pitch_um * self._step, pitch_um
        self._picture: _Picture | None = None
        self._changed = Condition()
        self._ended = False
        self._error: str | None = None
        self._solved: deque[float] = deque()
        self._shown: deque[float] = deque()
        self._age_ms: float | None = None
        self._thread = Thread(target=self._solve, name="live view", daemon=True)

    def start(self) -> None:
        """Begin to solve."""
        self._thread.start()

    def close(self) -> None:
        """End, and release the source."""
        with self._changed:
            self._ended = True
            self._changed.notify_all()
        self._live.close()
        self._recorder.close()
        if self._thread.is_alive():
            self._thread.join(timeout=10.0)

    def routes(self) -> list[BaseRoute]:
        """Return the routes of the page."""
        return [Route("/api/live", self._facts), WebSocketRoute("/api/live/pictures", self._pictures)]

    def _facts(self, _: Request) -> Response:
        """Return the facts that the page needs before it draws."""
        return json_answer(
            {
                "key": "live", "kind": "live", "title": readable(self._name), "pages": 1, "doubts": list(self._doubts),
                "rows": self._shape[0], "columns": self._shape[1], "pitch_um": self._pitch_um,
                "levels": level_count(self._shape), "padded": padded_shape(self._shape),
                "low_um": 0.0, "high_um": 50.0 * self._pitch_um, "steep": 0.35, "record": {},
                "sigma": self._live.has_sigma,
            }
        )  # fmt: skip

    def _solve(self) -> None:
        try:
            for solved in self._live:
                picture = self._drawn(solved)
                with self._changed:
                    self._picture = picture
                    self._changed.notify_all()
                if self._ended:
                    return
        except (HostError, DeviceError, HalError, OSError) as error:
            self._error = str(error)
        with self._changed:
            self._ended = True
            self._changed.notify_all()

    def _drawn(self, solved: SolvedFrame) -> _Picture:
        """Return the picture of a frame."""
        now = time.monotonic_ns()
        _counted(self._solved, now * 1e-9)
        taken_ns = now if solved.frame.taken_ns is None else solved.frame.taken_ns
        contact = find_contact(solved.height_um, self._full_pitch_um, solved.sigma_um)
        z_um = self._reduced(solved.height_um)
        known = z_um[np.isfinite(z_um)]
        header: dict[str, Any] = {
            "number": solved.number,
            "time_s": self._live.time_s(solved),
            "problem": None if solved.reason is None else readable(solved.reason),
            "relative": solved.statistics is not None and solved.statistics.is_relative,
            "depth_um": contact.depth_um,
            "depth_sigma_um": contact.depth_sigma_um,
            "area_mm2": contact.area_mm2,
            "area_sigma_mm2": contact.area_sigma_mm2,
            "centre": contact.centre,
            "low_um": float(known.min()) if known.size else 0.0,
            "high_um": float(known.max()) if known.size else 1.0,
            "steep": steep_slope(HeightMap(z_um, self._pitch_um), 160),
            "sigma_um": float(np.nanmedian(solved.sigma_um)) if solved.sigma_um is not None and known.size else None,
        }
        return _Picture(solved.number, taken_ns, header, surface_bytes(z_um, self._pitch_um))

    def _reduced(self, z_um: Float32Array) -> Float32Array:
        if self._step == 1:
            return z_um
        return np.asarray(cv2.resize(z_um, self._shape[::-1], interpolation=cv2.INTER_AREA), np.float32)

    async def _pictures(self, socket: WebSocket) -> None:
        await socket.accept()
        room = asyncio.Event()
        taken: dict[int, int] = {}
        reader = asyncio.create_task(self._listen(socket, taken, room))
        last = -1
        try:
            while not reader.done():
                if len(taken) >= AHEAD:
                    room.clear()
                    with suppress(TimeoutError):
                        await asyncio.wait_for(room.wait(), timeout=1.0)
                    continue
                picture = await asyncio.to_thread(self._next, last)
                if picture is not None and picture.number != last:
                    last = picture.number
                    taken[last] = picture.taken_ns
                    await socket.send_bytes(_message(picture.header | self._state(), picture.body))
                else:
                    await socket.send_bytes(_message(self._state(), b""))
                if self._ended:
                    break
        except (WebSocketDisconnect, RuntimeError):
            pass
        finally:
            reader.cancel()

    def _next(self, last: int) -> _Picture | None:
        """Return a newer picture than the last; None after a second without one, for the page to see the state."""
        with self._changed:
            self._changed.wait_for(
                lambda: self._ended or (self._picture is not None and self._picture.number != last), timeout=1.0
            )
            return self._picture

    async def _listen(self, socket: WebSocket, taken: dict[int, int], room: asyncio.Event) -> None:
        """Take what the page says: pictures that it has drawn, and when to record."""
        try:
            while True:
                words = msgspec.json.decode(await socket.receive_text(), type=_FromPage)
                if words.record is not None:
                    await asyncio.to_thread(self._recorder.record if words.record else self._recorder.stop)
                if words.drawn is not None and (taken_ns := taken.pop(words.drawn, None)) is not None:
                    now = time.monotonic_ns()
                    self._age_ms = (now - taken_ns) * 1e-6
                    _counted(self._shown, now * 1e-9)
                    room.set()
        except (WebSocketDisconnect, RuntimeError, msgspec.DecodeError):
            return

    def _state(self) -> dict[str, Any]:
        """Return what the page shows of the stream itself."""
        problem = self._error or self._live.problem
        return {
            "solved_hz": _rate(self._solved),
            "shown_hz": _rate(self._shown),
            "age_ms": self._age_ms,
            "dropped": self._live.dropped,
            "read": self._live.read,
            "lost": None if problem is None else readable(problem),
            "ended": self._ended,
            "recording": self._recorder.state(),
        }


class _FromPage(msgspec.Struct, forbid_unknown_fields=True):
    """A page's message: the number of a picture that it has drawn, or whether to record."""

    drawn: int | None = None
    record: bool | None = None


def surface_bytes(z_um: Float32Array, pitch_um: float) -> bytes:
    """Return every level of a surface as the page takes it, fine to coarse."""
    levels = coarse_levels(z_um, pitch_um) if level_count(z_um.shape) > 1 else []
    finest = finest_rows(z_um, pitch_um, levels[0] if levels else None, 0, padded_shape(z_um.shape)[0])
    parts: list[bytes] = []
    for level in (finest, *levels):
        # Half floats of the next level begin at a multiple of their size.
        parts += [level.surface.tobytes(), level.valid.tobytes(), bytes(-level.valid.size % 8)]
    return b"".join(parts)


def _message(header: dict[str, Any], body: bytes) -> bytes:
    """Return header and body of a message; the header is padded so that the body's half floats are aligned."""
    words = msgspec.json.encode(header)
    words += b" " * (-(len(words) + 4) % 8)
    return struct.pack("<I", len(words)) + words + body


def _counted(times: deque[float], now: float) -> None:
    times.append(now)
    while times[0] < now - RATE_OVER_S:
        times.popleft()


def _rate(times: deque[float]) -> float | None:
    """Return events per second over the last `RATE_OVER_S`; None of too few."""
    begin_s = time.monotonic() - RATE_OVER_S
    count = sum(stamp > begin_s for stamp in tuple(times))
    return count / RATE_OVER_S if count > 1 else None
