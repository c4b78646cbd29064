"""Records the frames of a sensor as they come, so that `retrosync video` reconstructs every one of them later."""

from __future__ import annotations

import time
from pathlib import Path
from queue import Empty, Full, Queue
from threading import Event, Lock, Thread
from typing import Any, Final

import cv2
import msgspec

from device.bundles.raw_frame import write_raw
from hal.frame import RawFrame
from host_sync.frames.sequence import TIMES_FILE, BadFrame, StoredFrame

WAITING: Final = 32
"""Frames that may wait for the disk; further ones are lost and counted."""


class Recorder:
    """Writes frames to a new folder for each recording.

    root : folder of the recordings
    calibration : named in each recording's own `times.json`
    """

    def __init__(self, root: Path, calibration: str = "") -> None:
        self._root, self._calibration = root, calibration
        self._queue: Queue[tuple[StoredFrame, int]] = Queue(WAITING)
        self._lock = Lock()
        self._folder: Path | None = None
        self._count = self._lost = 0
        self._times_ns: list[int] = []
        self._problem: str | None = None
        self._closing = Event()
        self._thread: Thread | None = None

    def take(self, frame: StoredFrame | BadFrame) -> None:
        """Take a frame of the sensor; it is written where a recording runs."""
        if self._folder is None or isinstance(frame, BadFrame):
            return
        try:
            taken_ns = time.monotonic_ns() if frame.taken_ns is None else frame.taken_ns
            self._queue.put_nowait((frame, taken_ns))
        except Full:
            self._lost += 1

    def record(self) -> None:
        """Begin a recording."""
        with self._lock:
            if self._folder is not None:
                return
            folder = self._root / time.strftime("%Y-%m-%dT%H-%M-%S")
            try:
                folder.mkdir(parents=True)
            except OSError as error:
                self._problem = f"{folder} cannot be written ({error.strerror}): choose another --record folder"
                return
            self._count = self._lost = 0
            self._times_ns, self._problem = [], None
            self._queue = Queue(WAITING)  # a frame that came while the last recording ended is not of this one
            self._closing.clear()
            self._folder = folder
            self._thread = Thread(target=self._write_all, args=(folder,), name="recorder", daemon=True)
            self._thread.start()

    def stop(self) -> None:
        """End the recording when all its frames are on disk."""
        with self._lock:
            if self._folder is None:
                return
            self._folder = None
            self._closing.set()
            if self._thread is not None:
                self._thread.join()

    close = stop

    def state(self) -> dict[str, Any]:
        """Return what a page shows: whether it records, where to, how many frames are written and lost."""
        folder = self._folder
        return {
            "folder": None if folder is None else str(folder),
            "frames": self._count,
            "lost": self._lost,
            "problem": self._problem,
        }

    def _write_all(self, folder: Path) -> None:
        while True:
            try:
                frame, taken_ns = self._queue.get(timeout=0.1)
            except Empty:
                if self._closing.is_set():
                    break
                continue
            try:
                _write(folder / f"frame-{self._count + 1:06d}", frame)
            except OSError as error:
                self._problem = f"{folder} cannot be written ({error.strerror}): free space, then record again"
                self._folder = None
                break
            self._count += 1
            self._times_ns.append(taken_ns)
        _write_times(folder, self._times_ns, self._lost, self._calibration)


def _write(path: Path, frame: StoredFrame) -> None:
    """Write a frame without loss: a raw frame as TIFF, a picture as PNG."""
    if isinstance(frame.pixels, RawFrame):
        write_raw(path.with_suffix(".tif"), frame.pixels)
        return
    pixels = cv2.cvtColor(frame.pixels, cv2.COLOR_RGB2BGR)
    data = cv2.imencode(".png", pixels, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1]
    path.with_suffix(".png").write_bytes(data.tobytes())


def _write_times(folder: Path, times_ns: list[int], lost: int, calibration: str) -> None:
    seconds = [(one - times_ns[0]) * 1e-9 for one in times_ns]
    record = {"schema": "retrograph.recording/1", "times_s": seconds, "lost": lost, "calibration": calibration}
    (folder / TIMES_FILE).write_bytes(msgspec.json.encode(record))
