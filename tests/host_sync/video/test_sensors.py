"""Sensors: unplugged and found again, recordings in real time, what a recorder keeps; all in virtual time."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from hal.clock import VirtualClock
from hal.errors import CameraError
from hal.profile_tables import profile_folder
from host_sync.errors import SequenceError, SourceError
from host_sync.frames.sequence import BadFrame, StoredFrame, open_sequence
from host_sync.video import sensors
from host_sync.video.sensors import PlayedCapture, Recorder, Sensor, is_sensor, open_sensor

SHAPE = (6, 8)


def picture(value: int) -> StoredFrame:
    return StoredFrame(f"picture {value}", np.full((*SHAPE, 3), value, np.uint8))


class Plugged:
    """A capture that gives some pictures and is then unplugged."""

    def __init__(self, *values: int) -> None:
        self._values = list(values)
        self.closed = False

    def read(self) -> tuple[StoredFrame, int]:
        if not self._values:
            raise CameraError("camera X does not answer: plug it in again")
        return picture(self._values.pop(0)), 5

    def close(self) -> None:
        self.closed = True


def test_a_sensor_that_is_unplugged_is_said_and_found_again() -> None:
    clock, first = VirtualClock(), Plugged(1, 2)
    answers: list[Plugged | Exception] = [first, SourceError("is absent"), Plugged(3)]

    def opened() -> Plugged:
        answer = answers.pop(0)
        if answer is not first:
            problems.append(sensor.problem)
        if isinstance(answer, Exception):
            raise answer
        return answer

    problems: list[str | None] = []
    sensor = Sensor("X", opened, clock)
    frames = sensor.frames()
    seen = [next(frames) for _ in range(3)]
    problems.append(sensor.problem)
    assert [int(frame.pixels[0, 0, 0]) for frame in seen] == [1, 2, 3]
    assert [(frame.number, frame.taken_ns) for frame in seen] == [(0, 5), (1, 5), (2, 5)]
    assert problems == ["camera X does not answer: plug it in again", "is absent", None]
    assert clock.monotonic_ns() == 2_000_000_000
    assert first.closed
    frames.close()


def test_a_sensor_that_is_absent_at_the_start_is_refused() -> None:
    def opened() -> Plugged:
        raise SourceError("camera 7 cannot be opened")

    with pytest.raises(SourceError, match="camera 7"):
        Sensor("camera 7", opened)


class Recorded:
    rate_hz = 20.0
    count = 3

    def frames(self) -> Iterator[StoredFrame | BadFrame]:
        yield from (picture(1), BadFrame("torn", "torn: is cut"), picture(2))


def test_a_recording_is_played_in_its_own_time() -> None:
    clock = VirtualClock(start_ns=7)
    played = PlayedCapture(Recorded(), clock=clock)
    seen = [played.read() for _ in range(4)]
    assert [None if one is None else one[1] for one in seen] == [50_000_007, 100_000_007, 150_000_007, None]
    assert clock.monotonic_ns() == 150_000_007
    endless = PlayedCapture(Recorded(), endless=True, clock=clock)
    assert [endless.read()[0].name for _ in range(4)] == ["picture 1", "torn", "picture 2", "picture 1"]


def test_a_recording_that_is_read_too_slowly_is_played_more_slowly() -> None:
    """A frame is as old as its reading, however many were late before it."""

    class Slow(Recorded):
        def frames(self) -> Iterator[StoredFrame | BadFrame]:
            for frame in super().frames():
                clock.sleep(0.2)
                yield frame

    clock = VirtualClock()
    played = PlayedCapture(Slow(), clock=clock)
    assert [played.read()[1] for _ in range(3)] == [200_000_000, 400_000_000, 600_000_000]
    assert clock.monotonic_ns() == 600_000_000


def test_what_names_a_sensor_and_what_a_recording(tmp_path: Path) -> None:
    assert [is_sensor(name) for name in (0, "/dev/video2", "digit", "own.toml")] == [True] * 4
    assert not is_sensor(tmp_path)
    with pytest.raises(SequenceError, match="cannot be read"):
        open_sensor(str(tmp_path / "absent.mp4"), SHAPE)
    with pytest.raises(SourceError, match=r"absent\.toml"):
        open_sensor("absent.toml", SHAPE)
    with pytest.raises(SourceError, match="DIGIT"):
        open_sensor("digit", SHAPE)
    with pytest.raises(SourceError, match="camera 97 cannot be opened"):
        open_sensor("/dev/video97", SHAPE)


def test_the_twin_slides_there_and_back_and_begins_untouched(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(sensors, "TWIN_STEPS", 2)
    profile = (profile_folder() / "twin.toml").read_text()
    for old, new in (("columns = 1456", "columns = 182"), ("rows = 1088", "rows = 136"), ("um = 12.0 ", "um = 96.0 ")):
        profile = profile.replace(old, new)
    (tmp_path / "small.toml").write_text(profile)
    sensor = open_sensor(str(tmp_path / "small.toml"), (136, 182))
    frames = sensor.frames()
    rest, first, last, again, _ = (next(frames).pixels.mosaic.astype(float) for _ in range(5))
    frames.close()
    assert np.abs(first - rest).mean() > 5.0 * np.abs(np.diff(rest[::2, ::2])).mean() / 4.0
    assert np.abs(last - first).mean() > 0.2 * np.abs(first - rest).mean()
    np.testing.assert_array_equal(again, first)
    with pytest.raises(SourceError, match="use a calibration of this twin"):
        open_sensor(str(tmp_path / "small.toml"), (1088, 1456))


def test_a_recording_is_a_sequence_at_its_own_rate(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "recordings", "gel.calibration")
    recorder.take(picture(1))  # nothing is recorded yet
    recorder.record()
    for number in range(3):
        recorder.take(StoredFrame("X", picture(number).pixels, number, 40_000_000 * number))
    recorder.take(BadFrame("torn", "is torn"))
    recorder.stop()
    recorder.take(picture(9))
    (folder,) = (tmp_path / "recordings").iterdir()
    assert recorder.state() == {"folder": None, "frames": 3, "lost": 0, "problem": None}
    sequence = open_sequence(folder)
    assert sequence.rate_hz == pytest.approx(25.0)
    assert [int(frame.pixels[0, 0, 0]) for frame in sequence.frames()] == [0, 1, 2]
    assert json.loads((folder / "times.json").read_text())["calibration"] == "gel.calibration"
    assert [frame.taken_ns for frame in sequence.frames()] == [0, 40_000_000, 80_000_000]
    (folder / "frame-000002.png").unlink()
    assert {frame.taken_ns for frame in open_sequence(folder).frames()} == {None}


def test_a_disk_that_fills_while_it_records_leaves_no_torn_frame(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fill(path: Path, _: StoredFrame) -> None:
        path.with_suffix(".png").write_bytes(b"half")
        raise OSError(28, "No space left on device")

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("host_sync.video.sensors._write", fill)
    monkeypatch.setattr("host_sync.video.sensors._write_times", full)
    recorder = Recorder(tmp_path)
    recorder.record()
    thread = recorder._thread
    recorder.take(picture(1))
    assert thread is not None
    thread.join(timeout=10.0)
    assert "No space left on device" in str(recorder.state()["problem"])
    assert list(tmp_path.rglob("*.png")) == []


def test_a_frame_that_came_while_a_recording_ended_is_not_of_the_next(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path)
    recorder._queue.put((picture(1), 5))
    recorder.record()
    recorder.take(picture(2))
    recorder.stop()
    assert recorder.state()["frames"] == 1


def test_a_place_that_cannot_be_written_is_said(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    recorder = Recorder(tmp_path / "file")
    recorder.record()
    assert "cannot be written" in recorder.state()["problem"]
    recorder.close()
