"""Frames of a sensor that is plugged in, of the twin, or of a recording played in real time; and their recorder.

An unplugged sensor is reported and looked for again. This is the one module of the workstation that opens hardware, and
only that of a board profile. What is recorded can be reconstructed by `retrosync video`, every frame of it.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from queue import Empty, Full, Queue
from threading import Event, Lock, Thread
from typing import TYPE_CHECKING, Any, Final, Protocol

import cv2
import msgspec
import numpy as np

from device.bundles.raw_frame import write_raw
from hal.board_profile import BoardProfile, load_board_profile
from hal.clock import SystemClock
from hal.errors import HalError
from hal.frame import RawFrame
from hal.interfaces import Clock, LiftOff, PressObject
from hal.profile_tables import profile_names
from host_sync.errors import SourceError
from host_sync.frames.sequence import DEFAULT_RATE_HZ, TIMES_FILE, BadFrame, FrameSequence, StoredFrame, open_sequence

if TYPE_CHECKING:
    from hal.hardware import Hardware

RETRY_S: Final = 1.0
"""Time between two looks for a sensor that was unplugged."""

TIMEOUT_S: Final = 2.0
MAX_DROPPED: Final = 12
"""Frames until a camera grants its settings, at most."""

TWIN_OBJECT: Final = "coin"
TWIN_STEPS: Final = 16
TWIN_STEP_MM: Final = 0.25
TWIN_STEP_DEG: Final = 6.0
TWIN_RATE_HZ: Final = 30.0

_CAMERA: Final = re.compile(r"(?:/dev/video)?(\d+)")
Shape = tuple[int, int]


class Capture(Protocol):
    """An open sensor."""

    def read(self) -> tuple[StoredFrame | BadFrame, int] | None:
        """Return the next frame and the monotonic time (ns) at which it was taken; None at the end of a recording."""

    def close(self) -> None:
        """Release it."""


class Sensor:
    """Frames of a source in real time, without end where it is a sensor.

    opened : opens the source
    problem : the sentence on a sensor that is lost and looked for; None while it gives frames
    """

    def __init__(self, name: str, opened: Callable[[], Capture], clock: Clock | None = None) -> None:
        self.name = name
        self.problem: str | None = None
        self._open, self._clock = opened, clock or SystemClock()
        self._capture: Capture | None = opened()
        self._closed = False

    def frames(self) -> Iterator[StoredFrame | BadFrame]:
        """Yield frames, numbered as they come, until the source ends or is closed."""
        number = 0
        try:
            while not self._closed:
                try:
                    if self._capture is None:
                        self._capture = self._open()
                        self.problem = None
                    found = self._capture.read()
                except (HalError, SourceError) as error:
                    self._release()
                    self.problem = str(error)
                    self._clock.sleep(RETRY_S)
                    continue
                if found is None:
                    return
                frame, taken_ns = found
                yield replace(frame, number=number, taken_ns=taken_ns)
                number += 1
        finally:
            self._release()

    def close(self) -> None:
        """End with the next frame."""
        self._closed = True

    def _release(self) -> None:
        capture, self._capture = self._capture, None
        if capture is not None:
            capture.close()


def is_sensor(source: int | str | Path) -> bool:
    """Return whether a source is named as a sensor, and not as a recording."""
    words = str(source)
    return bool(_CAMERA.fullmatch(words)) or words in profile_names() or words.endswith(".toml")


def open_sensor(
    source: int | str | Path, shape: Shape, report_progress: Callable[[str], None] = lambda _: None
) -> Sensor:
    """Open the sensor of a board profile, a camera, or a recording, which is played in real time.

    source : name or file of the profile, number or /dev/video file of the camera, or the recording
    shape : (H, W) of the calibration's frames, which a camera is asked for
    report_progress : is given a few words while the source is prepared

    Raises
    ------
    SourceError, SequenceError
        There is no such source, or it cannot be opened.
    """
    try:
        return _opened_sensor(str(source), shape, report_progress)
    except HalError as error:
        raise SourceError(str(error)) from error


def _opened_sensor(words: str, shape: Shape, report_progress: Callable[[str], None]) -> Sensor:
    camera = _CAMERA.fullmatch(words)
    if camera:
        return Sensor(f"camera {camera[1]}", lambda: CameraCapture(int(camera[1]), shape))
    if is_sensor(words):
        profile = load_board_profile(words)
        if profile.driver.startswith("twin"):
            report_progress("the twin renders a coin that slides")
            recording = _TwinSlide(words, shape)
            return Sensor(words, lambda: PlayedCapture(recording, endless=True))
        return Sensor(words, lambda: ProfileCapture(words))
    sequence = open_sequence(Path(words))
    return Sensor(Path(words).name, lambda: PlayedCapture(sequence))


def _hardware(profile: BoardProfile, clock: Clock | None = None) -> Hardware:
    """Return the hardware of a profile; its drivers are imported only now."""
    from hal.factory import open_hardware

    return open_hardware(profile, clock)


def _begin_lit(hardware: Hardware) -> None:
    """Switch the lights of a profile on, and drop frames until the camera has the profile's settings."""
    profile = hardware.profile
    settings, step_us = profile.camera.settings, profile.sensor.exposure_step_us
    hardware.camera.apply(settings)
    hardware.lights.switch_on(profile.currents_ma)
    for _ in range(MAX_DROPPED):
        if settings.is_granted(hardware.camera.next_frame(TIMEOUT_S).granted, step_us):
            return
    camera = hardware.camera.camera_id
    raise SourceError(f"camera {camera} does not grant exposure and gain of its profile: check these")


class CameraCapture:
    """A camera that OpenCV opens: its pictures must have the size of the calibration's frames."""

    def __init__(self, index: int, shape: Shape) -> None:
        self._name, self._clock = f"camera {index}", SystemClock()
        self._camera = cv2.VideoCapture(index)
        rows, columns = shape
        for setting, value in (
            (cv2.CAP_PROP_FRAME_WIDTH, columns), (cv2.CAP_PROP_FRAME_HEIGHT, rows), (cv2.CAP_PROP_BUFFERSIZE, 1),
        ):  # fmt: skip
            self._camera.set(setting, value)
        if not self._camera.isOpened():
            self._camera.release()
            raise SourceError(f"{self._name} cannot be opened: plug it in, or name another number or /dev/video file")

    def read(self) -> tuple[StoredFrame | BadFrame, int]:
        """Return the next picture."""
        found, picture = self._camera.read()
        if not found:
            raise SourceError(f"{self._name} gives no picture any more: plug it in again")
        rgb = np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB), np.uint8)
        return StoredFrame(self._name, rgb), self._clock.monotonic_ns()

    def close(self) -> None:
        """Release the camera."""
        self._camera.release()


class ProfileCapture:
    """The camera of a board profile, its lights on."""

    def __init__(self, name: str) -> None:
        profile = load_board_profile(name)
        hardware = _hardware(profile, SystemClock())
        with ExitStack() as stack:
            stack.enter_context(hardware.lights)
            stack.enter_context(hardware.camera)
            _begin_lit(hardware)
            self._held = stack.pop_all()
        self._camera, self._name = hardware.camera, name

    def read(self) -> tuple[StoredFrame | BadFrame, int]:
        """Return the next frame that the sensor completes."""
        frame = self._camera.next_frame(TIMEOUT_S)
        return StoredFrame(self._name, frame), frame.sensor_timestamp_ns

    def close(self) -> None:
        """Switch the lights off and release the camera."""
        self._held.close()


class PlayedCapture:
    """A recording in real time; without end where it begins again.

    clock : the time that it is played in
    """

    def __init__(self, sequence: FrameSequence, *, endless: bool = False, clock: Clock | None = None) -> None:
        self._sequence, self._endless, self._clock = sequence, endless, clock or SystemClock()
        self._period_ns = round(1e9 / (sequence.rate_hz or DEFAULT_RATE_HZ))
        self._frames = sequence.frames()
        self._due_ns = self._clock.monotonic_ns()

    def read(self) -> tuple[StoredFrame | BadFrame, int] | None:
        """Return the next frame when its time has come."""
        frame = next(self._frames, None)
        if frame is None and self._endless:
            self._frames = self._sequence.frames()
            frame = next(self._frames, None)
        if frame is None:
            return None
        # What cannot be read in its own time is played as fast as it is read, or its age would grow without end.
        self._due_ns = max(self._due_ns + self._period_ns, self._clock.monotonic_ns())
        self._clock.sleep((self._due_ns - self._clock.monotonic_ns()) * 1e-9)
        return frame, self._due_ns

    def close(self) -> None:
        """Nothing is held."""


class _TwinSlide:
    """Frames of a coin that slides over the twin's skin and back; the first shows untouched skin."""

    rate_hz = TWIN_RATE_HZ

    def __init__(self, name: str, shape: Shape) -> None:
        hardware = _hardware(load_board_profile(name))
        self._frames: list[RawFrame] = []
        with hardware.lights, hardware.camera:
            hardware.operator.ask(LiftOff())
            _begin_lit(hardware)
            self._frames.append(hardware.camera.next_frame(TIMEOUT_S))
            for step in range(TWIN_STEPS):
                way = None if step == 0 else (TWIN_STEP_MM, 0.5 * TWIN_STEP_MM, TWIN_STEP_DEG)
                hardware.operator.ask(PressObject(TWIN_OBJECT, way, pushes=False))
                self._frames.append(hardware.camera.next_frame(TIMEOUT_S))
        first = self._frames[0]
        if first.shape != shape and first.shape[0] < 2 * shape[0]:
            raise SourceError(
                f"the twin's frames have {first.shape[1]}x{first.shape[0]} pixels and the calibration's "
                f"{shape[1]}x{shape[0]}: use a calibration of this twin (retroscan --board {name} calibrate)"
            )

    @property
    def count(self) -> int:
        """Number of frames, there and back."""
        return len(self._frames) + TWIN_STEPS - 1

    def frames(self) -> Iterator[StoredFrame | BadFrame]:
        """Yield every frame."""
        for number, frame in enumerate([*self._frames, *self._frames[-2:0:-1]]):
            yield StoredFrame(f"twin {number}", frame)


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
            name = f"frame-{self._count + 1:06d}"
            try:
                _write(folder / name, frame)
            except OSError as error:
                for partial in folder.glob(f"{name}.*"):
                    partial.unlink()
                self._problem = f"{folder} cannot be written ({error.strerror}): free space, then record again"
                self._folder = None
                break
            self._count += 1
            self._times_ns.append(taken_ns)
        try:
            _write_times(folder, self._times_ns, self._lost, self._calibration)
        except OSError as error:
            self._problem = f"{folder / TIMES_FILE} cannot be written ({error.strerror}): free space, then record again"


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
