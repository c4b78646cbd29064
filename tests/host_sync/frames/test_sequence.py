"""Sequences from folders, stacks and movies; damaged frames are named."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from PIL import Image

from device.bundles.raw_frame import write_raw
from hal.frame import RawFrame
from host_sync.errors import SequenceError
from host_sync.frames.sequence import BadFrame, StoredFrame, open_sequence

VALUES = 20, 60, 100


def picture(value: int, dtype: type = np.uint8) -> np.ndarray:
    rgb = np.zeros((24, 32, 3), dtype)
    rgb[..., 0], rgb[..., 2] = value, 200
    return rgb


def test_a_folders_frames_come_in_natural_order(tmp_path: Path) -> None:
    for number in (10, 9, 100, 1):
        cv2.imwrite(str(tmp_path / f"Frame-{number}.png"), picture(number)[..., ::-1])
    (tmp_path / "notes.txt").write_text("no frame")
    (tmp_path / ".hidden.png").write_text("no frame")
    sequence = open_sequence(tmp_path)
    frames = list(sequence.frames())
    assert sequence.count == 4
    assert [frame.name for frame in frames] == ["Frame-1.png", "Frame-9.png", "Frame-10.png", "Frame-100.png"]
    assert [int(frame.pixels[0, 0, 0]) for frame in frames] == [1, 9, 10, 100]
    assert frames[0].shape == (24, 32)


def test_a_folder_of_raw_frames_with_bad_ones_among_them(tmp_path: Path, raw_frame: Callable[[int], RawFrame]) -> None:
    for number in range(3):
        write_raw(tmp_path / f"{number}.tif", raw_frame(number))
    data = (tmp_path / "1.tif").read_bytes()
    (tmp_path / "1.tif").write_bytes(data[:-300])
    cv2.imwrite(str(tmp_path / "3.png"), np.zeros((32, 48), np.uint8))
    first, torn, last, grey = open_sequence(tmp_path).frames()
    assert isinstance(first, StoredFrame)
    assert isinstance(last, StoredFrame)
    np.testing.assert_array_equal(last.pixels.mosaic, raw_frame(2).mosaic)
    assert isinstance(torn, BadFrame)
    assert "1.tif" in torn.reason
    assert "is grey" in grey.reason


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_the_pages_of_a_stack_are_frames(tmp_path: Path, dtype: type) -> None:
    path = tmp_path / "stack.tif"
    tifffile.imwrite(path, np.stack([picture(value, dtype) for value in (3, 4, 5)]), photometric="rgb")
    sequence = open_sequence(path)
    frames = list(sequence.frames())
    assert sequence.count == 3
    assert [int(frame.pixels[0, 0, 0]) for frame in frames] == [3, 4, 5]
    assert frames[0].pixels.dtype == dtype


def test_a_page_unlike_the_first_is_named(tmp_path: Path) -> None:
    path = tmp_path / "stack.tif"
    with tifffile.TiffWriter(path) as stack:
        for rows in (24, 12, 24):
            stack.write(picture(7)[:rows], photometric="rgb")
    good, bad, after = open_sequence(path).frames()
    assert isinstance(good, StoredFrame)
    assert isinstance(after, StoredFrame)
    assert "page 2: is damaged or differs from the first page" in bad.reason


@pytest.mark.parametrize("options", [{}, {"bigtiff": True}, {"byteorder": ">"}])
def test_a_stack_that_was_cut_says_so_after_the_pages_it_still_has(tmp_path: Path, options: dict[str, object]) -> None:
    path = tmp_path / "stack.tif"
    with tifffile.TiffWriter(path, **options) as stack:
        for value in (1, 2, 3, 4):
            stack.write(picture(value), photometric="rgb", contiguous=False)
    whole = path.read_bytes()
    assert all(isinstance(frame, StoredFrame) for frame in open_sequence(path).frames())
    path.write_bytes(whole[: len(whole) // 2])
    sequence = open_sequence(path)
    *pages, rest = sequence.frames()
    assert 1 <= len(pages) < 4
    assert sequence.count == len(pages) + 1
    assert isinstance(rest, BadFrame)
    assert f"all after page {len(pages)} is missing" in rest.reason


@pytest.fixture
def movie(tmp_path: Path) -> Path:
    """Three frames, whose red is `VALUES`."""
    path = tmp_path / "press.avi"
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*"MJPG"), 30.0, (32, 24))
    for value in VALUES:
        writer.write(picture(value)[..., ::-1])
    writer.release()
    return path


def test_the_frames_of_a_movie_are_r_g_b(movie: Path) -> None:
    sequence = open_sequence(movie)
    frames = list(sequence.frames())
    assert (sequence.count, sequence.rate_hz) == (3, pytest.approx(30.0))
    for frame, value in zip(frames, VALUES, strict=True):
        np.testing.assert_allclose(frame.pixels.mean(axis=(0, 1)), [value, 0, 200], atol=6.0)


def test_what_is_no_file_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.png")
    (frame,) = open_sequence(tmp_path).frames()
    assert isinstance(frame, BadFrame)
    assert "is not a file" in frame.reason


def test_the_last_frame_of_a_movie_that_is_cut_is_named_alone(movie: Path) -> None:
    whole = movie.read_bytes()
    movie.write_bytes(whole[: whole.rindex(b"00dc", 0, whole.index(b"idx1"))])
    *_, last = open_sequence(movie).frames()
    assert isinstance(last, BadFrame)
    assert last.name == "frame 3"


def test_a_movies_decoder_prints_nothing(tmp_path: Path) -> None:
    """In its own process: the decoder reads its log level once."""
    torn = tmp_path / "torn.mp4"
    torn.write_bytes(b"\0\0\0\x18ftypisom\0\0\2\0isomiso2" + bytes(64))
    opening = "import sys, pathlib; from host_sync.frames.sequence import *; MovieSequence(pathlib.Path(sys.argv[1]))"
    command = [sys.executable, "-c", opening, str(torn)]
    said = subprocess.run(command, capture_output=True, text=True, check=False).stderr
    assert said.splitlines()[-1].endswith("holds no frames that can be decoded: convert it, or fetch it again")
    assert "moov" not in said


def test_what_holds_no_frames_is_refused_in_a_sentence(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "words.avi").write_text("no movie at all")
    (tmp_path / "torn.tif").write_bytes(b"II*\0\x08\0\0\0")
    tifffile.imwrite(tmp_path / "grey.tif", np.zeros((3, 24, 32), np.uint8), photometric="minisblack")
    for name, words in (
        ("empty", "holds no PNG, TIFF or JPEG"),
        ("words.avi", "is not a folder of frames"),
        ("torn.tif", "truncated or damaged"),
        ("grey.tif", "save RGB pages"),
        ("absent", "cannot be read"),
    ):
        with pytest.raises(SequenceError, match=words) as refused:
            open_sequence(tmp_path / name)
        assert name in str(refused.value)


def test_a_frame_that_is_marked_as_turned_otherwise_is_left_out_by_name(tmp_path: Path) -> None:
    exif = Image.Exif()
    pixels = np.random.default_rng(2).integers(0, 256, (12, 16, 3)).astype(np.uint8)
    for number, orientation in enumerate((6, 6, 1), start=1):
        exif[274] = orientation
        Image.fromarray(pixels).save(tmp_path / f"f{number}.png", exif=exif)
    first, second, third = open_sequence(tmp_path).frames()
    assert isinstance(first, StoredFrame)
    assert isinstance(second, StoredFrame)
    assert np.array_equal(first.pixels, np.rot90(pixels, -1))
    assert isinstance(third, BadFrame)
    assert "f3.png is marked as turned otherwise than" in third.reason
