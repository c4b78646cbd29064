"""Result files that are damaged or lie about their size: one error type, and no memory spent on what they declare."""

import struct
import tracemalloc
import zlib
from collections.abc import Callable
from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest
import tifffile

from host_sync.errors import UnreadableResult
from host_sync.results.field_file import (
    MAX_PIXELS,
    read_field,
    read_mask,
    read_samples,
    read_shape,
    read_stack_page,
    write_mask,
)
from host_sync.results.files import (
    EXTRAPOLATED_FILE,
    HEIGHT_FILE,
    HEIGHT_SIGMA_FILE,
    RECORD_FILE,
    SAMPLES_FILE,
    SLOPE_SIGMA_FILE,
)
from host_sync.results.reader import max_sample_values, read_result
from host_sync.results.record import ResultRecord, encode_record, read_listed_record, read_record
from host_sync.uncertainty.height_error import SAMPLES, reduced_size

SHAPE = (40, 60)
MUTATIONS = 100
Z_UM = np.random.default_rng(1).normal(size=SHAPE).astype(np.float32)


def record() -> ResultRecord:
    return ResultRecord(name="r", rows=SHAPE[0], columns=SHAPE[1], pixel_pitch_um=2.0, warnings=("w",))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A whole result folder."""
    for name in (HEIGHT_FILE, HEIGHT_SIGMA_FILE, SLOPE_SIGMA_FILE):
        tifffile.imwrite(tmp_path / name, Z_UM, tile=(16, 16), metadata=None)
    samples = np.stack([Z_UM[::2, ::2]] * 3)
    tifffile.imwrite(
        tmp_path / SAMPLES_FILE, samples, photometric="minisblack", compression="zlib", predictor=True, metadata=None
    )
    write_mask(tmp_path / EXTRAPOLATED_FILE, Z_UM > 1.0)
    (tmp_path / RECORD_FILE).write_bytes(encode_record(record()))
    return tmp_path


def mutated(data: bytes, rng: np.random.Generator) -> bytes:
    """The bytes with some replaced, cut out, repeated or cut off; most damage is done to the beginning and the end."""
    changed = bytearray(data)
    for _ in range(int(rng.integers(1, 5))):
        reach = len(changed) if rng.random() < 0.3 else min(512, len(changed))
        place = int(rng.integers(0, reach)) if rng.random() < 0.6 else len(changed) - 1 - int(rng.integers(0, reach))
        kind = int(rng.integers(0, 4))
        if kind == 0:
            changed[place] = int(rng.integers(0, 256))
        elif kind == 1:
            changed[place : place + 4] = struct.pack("<I", int(rng.choice([0, 1, 0xFFFFFFFF, 0x80000000, 1 << 20])))
        elif kind == 2:
            del changed[place : place + int(rng.integers(1, 64))]
        else:
            changed = changed[: max(place, 1)] if rng.random() < 0.2 else changed + changed[:place]
        changed = changed or bytearray(b"\0")
    return bytes(changed)


@pytest.mark.parametrize(
    "name", [RECORD_FILE, HEIGHT_FILE, HEIGHT_SIGMA_FILE, SLOPE_SIGMA_FILE, SAMPLES_FILE, EXTRAPOLATED_FILE]
)
def test_a_mutated_file_is_read_or_refused_with_one_error(folder: Path, name: str) -> None:
    """Any other exception ends the test; a file that is still read has the size of its record."""
    whole = (folder / name).read_bytes()
    rng = np.random.default_rng(len(name))
    refused = 0
    for _ in range(MUTATIONS):
        (folder / name).write_bytes(mutated(whole, rng))
        try:
            surface = read_result(folder)
        except UnreadableResult:
            refused += 1
        else:
            assert surface.height.z_um.shape == (surface.record.rows, surface.record.columns)
    assert refused > MUTATIONS // 10


@pytest.mark.parametrize("read", [read_shape, read_field])
def test_a_mutated_quick_look_is_read_or_refused_with_one_error(tmp_path: Path, read: Callable[[Path], object]) -> None:
    path = tmp_path / "quick-look-um.tif"
    tifffile.imwrite(path, Z_UM, description="height, um")
    whole = path.read_bytes()
    rng = np.random.default_rng(5)
    outcomes = set()
    for _ in range(4 * MUTATIONS):
        path.write_bytes(mutated(whole, rng))
        try:
            read(path)
        except UnreadableResult:
            outcomes.add("refused")
        else:
            outcomes.add("read")
    assert outcomes == {"refused", "read"}


def tiff(path: Path, rows: int, columns: int, **tags: object) -> Path:
    """A small TIFF whose header declares a size."""
    tifffile.imwrite(path, np.zeros((64, 64), np.float32), metadata=None, **tags)
    with tifffile.TiffFile(path, mode="r+b") as made:
        page = made.pages.first
        for name, value in (("ImageLength", rows), ("ImageWidth", columns)):
            page.tags[name].overwrite(value)
        if "RowsPerStrip" in page.tags:
            page.tags["RowsPerStrip"].overwrite(rows)
    return path


def zlib_bomb(path: Path) -> Path:
    """A field of 64 x 64 whose one strip inflates to 200 MB."""
    tifffile.imwrite(path, np.zeros((64, 64), np.float32), metadata=None, compression="zlib")
    bomb = zlib.compress(bytes(200_000_000), 9)
    with tifffile.TiffFile(path, mode="r+b") as made:
        tags = made.pages.first.tags
        end = made.filehandle.size
        tags["StripOffsets"].overwrite(end)
        tags["StripByteCounts"].overwrite(len(bomb))
    with path.open("ab") as stream:
        stream.write(bomb)
    return path


@pytest.mark.parametrize(
    "make",
    [
        lambda path: tiff(path, 16384, 16384),
        lambda path: tiff(path, 8000, 8000),
        lambda path: tiff(path, 8000, 8000, compression="zlib"),
        lambda path: tiff(path, 64, 64, tile=(16, 16)) and tiled(path),
        zlib_bomb,
    ],
    ids=["beyond the budget", "more than the file holds", "one strip for all", "enormous tiles", "inflates"],
)
def test_a_declared_size_costs_no_memory(tmp_path: Path, make: Callable[[Path], Path]) -> None:
    path = make(tmp_path / "bomb.tif")
    tracemalloc.start()
    try:
        for read in (read_field, read_shape, read_samples):
            with pytest.raises(UnreadableResult):
                read(path)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 4_000_000


def tiled(path: Path) -> Path:
    """The same with tiles of a gigabyte."""
    with tifffile.TiffFile(path, mode="r+b") as made:
        for name in ("TileWidth", "TileLength"):
            made.pages.first.tags[name].overwrite(16384)
    return path


def test_a_mask_that_declares_another_size_is_not_decoded(tmp_path: Path) -> None:
    path = tmp_path / "mask.png"
    assert cv2.imwrite(str(path), np.zeros((9000, 9000), np.uint8))
    tracemalloc.start()
    try:
        with pytest.raises(UnreadableResult, match="not as large"):
            read_mask(path, SHAPE)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 4_000_000


def test_a_page_beyond_a_video_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "heights_um.tif"
    tifffile.imwrite(path, np.stack([Z_UM, Z_UM + 1.0]), photometric="minisblack", rowsperstrip=SHAPE[0], metadata=None)
    np.testing.assert_array_equal(read_stack_page(path, 1, SHAPE), Z_UM + 1.0)
    for page, shape in ((2, SHAPE), (0, (20, 60)), (10**12, SHAPE)):
        with pytest.raises(UnreadableResult):
            read_stack_page(path, page, shape)


def test_a_record_is_read_as_it_was_written(folder: Path) -> None:
    assert read_record(folder) == read_listed_record(folder) == record()


@pytest.mark.parametrize(
    "odd",
    [
        {"rows": MAX_PIXELS, "columns": 2},
        {"rows": 1 << 63},
        {"pixel_pitch_um": 1e300},
        {"schema": "retrograph.result/2"},
    ],
)
def test_a_record_beyond_its_bounds_is_refused(folder: Path, odd: dict[str, object]) -> None:
    (folder / RECORD_FILE).write_bytes(msgspec.json.encode(msgspec.to_builtins(record()) | odd))
    for read in (read_record, read_listed_record):
        with pytest.raises(UnreadableResult):
            read(folder)


@pytest.mark.parametrize(
    "shape", [(120, 160), (288, 384), (320, 320), (2000, 512), (513, 513), (1088, 1456), (3040, 4056)]
)
def test_samples_of_an_honest_result_of_any_size_are_read(shape: tuple[int, int]) -> None:
    columns, rows = reduced_size(shape)
    assert SAMPLES * rows * columns <= max_sample_values(shape)
