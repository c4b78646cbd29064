from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tifffile
from hypothesis import given, settings
from hypothesis import strategies as st

from device.bundles.raw_frame import read_raw, write_raw
from device.errors import RecordError
from hal.frame import BAYER_ORDERS, CameraSettings, RawFrame

MakeFrame = Callable[..., RawFrame]


@settings(max_examples=25, deadline=None)
@given(
    rows=st.integers(1, 20),
    columns=st.integers(1, 20),
    order=st.sampled_from(BAYER_ORDERS),
    exposure_us=st.floats(0.1, 1e7),
    timestamp_ns=st.integers(0, 2**62),
    seed=st.integers(0, 1000),
)
def test_a_frame_comes_back_exactly(
    tmp_path_factory: pytest.TempPathFactory, rows, columns, order, exposure_us, timestamp_ns, seed
) -> None:
    mosaic = np.random.default_rng(seed).integers(0, 65536, (2 * rows, 2 * columns), dtype=np.uint16)
    frame = RawFrame(mosaic, order, 256.0, 65535.0, CameraSettings(exposure_us, 1.0 + seed / 7), timestamp_ns)
    path = tmp_path_factory.mktemp("raw") / "raw.tif"
    write_raw(path, frame)
    back = read_raw(path)
    assert np.array_equal(back.mosaic, mosaic)
    assert back.mosaic.dtype == np.uint16
    assert (back.bayer_order, back.black_level_dn, back.white_level_dn) == (order, 256.0, 65535.0)
    assert (back.granted, back.sensor_timestamp_ns) == (frame.granted, timestamp_ns)


def test_any_tiff_reader_finds_four_planes_and_plain_json(tmp_path: Path, raw_frame: MakeFrame) -> None:
    path = tmp_path / "raw.tif"
    frame = raw_frame()
    write_raw(path, frame)
    with tifffile.TiffFile(path) as tiff:
        assert len(tiff.pages) == 4
        assert np.array_equal(tiff.pages[1].asarray(), frame.mosaic[0::2, 1::2])
        assert tiff.pages[0].compression == tifffile.COMPRESSION.ZSTD
        header = json.loads(tiff.pages[0].description)
    assert header["schema"] == "retrograph.raw/1"
    assert header["exposure_us"] == 1998.4


def test_a_noisy_twelve_megapixel_frame_stays_small(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    row, column = np.mgrid[:3040, :4056]
    level = 1200.0 + 900.0 * np.sin(column / 700.0) * np.cos(row / 500.0)
    noise = rng.normal(0.0, np.sqrt(level * 4095.0 / 10_000.0))  # shot noise of a full well of 10,000 e-
    frame = RawFrame(
        np.clip(level + noise, 0, 4095).astype(np.uint16), "RGGB", 256.0, 4095.0, CameraSettings(1e4, 1.0), 0
    )
    path = tmp_path / "raw.tif"
    write_raw(path, frame)
    assert path.stat().st_size <= 17e6


def test_every_damage_is_noticed_without_the_manifest(tmp_path: Path, raw_frame: MakeFrame) -> None:
    whole, path = tmp_path / "whole.tif", tmp_path / "bad.tif"
    frame = raw_frame()
    write_raw(whole, frame)
    data = whole.read_bytes()
    unharmed = 0
    for at in range(0, len(data), 3):
        flipped = bytearray(data)
        flipped[at] ^= 1 << (at % 8)
        path.write_bytes(flipped)
        try:
            back = read_raw(path)
        except RecordError as error:
            assert str(path) in str(error)  # noqa: PT017
        else:
            assert np.array_equal(back.mosaic, frame.mosaic)
            unharmed += 1
    assert unharmed < len(data) / 3 / 4


def test_truncation_is_named(tmp_path: Path, raw_frame: MakeFrame) -> None:
    path = tmp_path / "raw.tif"
    write_raw(path, raw_frame())
    data = path.read_bytes()
    for size in (0, 3, 8, 60, len(data) // 2, len(data) - 1):
        path.write_bytes(data[:size])
        with pytest.raises(RecordError, match=r"raw\.tif: .*fetch it again"):
            read_raw(path)


def test_other_files_are_refused_in_a_sentence(
    tmp_path: Path, raw_frame: MakeFrame, capfd: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(RecordError, match=r"gone\.tif: is missing"):
        read_raw(tmp_path / "gone.tif")
    other = tmp_path / "other.tif"
    tifffile.imwrite(other, np.zeros((4, 4), np.uint16))
    with pytest.raises(RecordError, match=r"other\.tif"):
        read_raw(other)
    newer = tmp_path / "newer.tif"
    tifffile.imwrite(newer, np.zeros((4, 4), np.uint16), description='{"schema": "retrograph.raw/9"}', metadata=None)
    with pytest.raises(RecordError, match=r"'retrograph\.raw/9', this program reads 'retrograph\.raw/1'"):
        read_raw(newer)
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(("pages", "compression"), [(5, "zstd"), (3, "zstd"), (4, "zlib"), (4, None)])
def test_only_four_pages_of_the_one_compression_are_unpacked(
    tmp_path: Path, raw_frame: MakeFrame, pages: int, compression: str | None
) -> None:
    path = tmp_path / "raw.tif"
    write_raw(path, raw_frame())
    with tifffile.TiffFile(path) as genuine:
        planes, description = genuine.asarray(), genuine.pages.first.description
    more = np.concatenate([planes, planes])[:pages]
    tifffile.imwrite(
        path, more, compression=compression, description=description, metadata=None, photometric="minisblack"
    )
    with pytest.raises(RecordError, match=r"not four planes of 24x16 with zstd|cannot be read"):
        read_raw(path)


def test_an_odd_mosaic_is_a_mistake_of_the_caller(tmp_path: Path, raw_frame: MakeFrame) -> None:
    with pytest.raises(ValueError, match="2x2 blocks"):
        write_raw(tmp_path / "raw.tif", raw_frame(shape=(31, 48)))
