"""Raw frames for other programs: independent readers find the very counts of the sensor."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest
import tifffile

from device.bundles.raw_frame import write_raw
from device.bundles.scan import Annotations, ScanBundle, ScanRecord
from device.store.store import BundleStore
from hal.frame import BAYER_ORDERS, BayerOrder, RawFrame
from host_sync.cli.main import main


@pytest.fixture(params=BAYER_ORDERS)
def scan_of(
    request: pytest.FixtureRequest,
    store: BundleStore,
    scan_record: Callable[..., ScanRecord],
    raw_frame: Callable[..., RawFrame],
) -> tuple[ScanBundle, RawFrame]:
    order: BayerOrder = request.param
    frame = raw_frame(3, (64, 96))
    frame = RawFrame(frame.mosaic, order, 256.0, 4095.0, frame.granted, frame.sensor_timestamp_ns)
    record = msgspec.structs.replace(scan_record(store), shape=frame.shape)
    return store.publish_scan(record, lambda folder: write_raw(folder / "raw.tif", frame)), frame


def export(scan: ScanBundle, store: BundleStore, out: Path, *forms: str) -> int:
    return main(["export", scan.scan_id, "--to", *forms, "--out", str(out), "--library", str(store.root)])


def test_a_raw_converter_reads_the_dng_exactly(
    scan_of: tuple[ScanBundle, RawFrame], store: BundleStore, tmp_path: Path
) -> None:
    rawpy = pytest.importorskip("rawpy")
    scan, frame = scan_of
    assert export(scan, store, tmp_path / "out", "dng") == 0
    with rawpy.imread(str(tmp_path / "out" / f"{scan.scan_id}.dng")) as raw:
        assert np.array_equal(raw.raw_image, frame.mosaic)
        assert raw.black_level_per_channel == [256, 256, 256, 256]
        assert raw.white_level == 4095
        colours = "".join(chr(raw.color_desc[index]) for index in raw.raw_pattern.ravel())
        assert colours == frame.bayer_order
        assert raw.postprocess(half_size=True).shape == (32, 48, 3)


def test_the_deflated_tiff_is_the_mosaic_with_its_scale(
    scan_of: tuple[ScanBundle, RawFrame], store: BundleStore, tmp_path: Path
) -> None:
    scan, frame = scan_of
    assert export(scan, store, tmp_path, "tiff", "dng") == 0
    with tifffile.TiffFile(tmp_path / f"{scan.scan_id}.tif") as tiff:
        page = tiff.pages.first
        assert page.compression == tifffile.COMPRESSION.ADOBE_DEFLATE
        assert np.array_equal(page.asarray(), frame.mosaic)
        across, unit = page.tags["XResolution"].value, page.tags["ResolutionUnit"].value
        assert unit == tifffile.RESUNIT.CENTIMETER
        assert across[0] / across[1] == pytest.approx(1e4 / scan.record.pixel_pitch_um)
        assert json.loads(page.description)["identity"]["id"] == scan.scan_id
    assert sorted(path.suffix for path in tmp_path.glob("rg*")) == [".dng", ".tif"]


def test_a_damaged_scan_and_a_place_in_the_way_are_refused(
    store: BundleStore, publish_scan: Callable[..., ScanBundle], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scan = publish_scan(store)
    (tmp_path / "file").touch()
    assert export(scan, store, tmp_path / "file", "tiff") == 2
    assert "name a folder" in capsys.readouterr().err
    scan.path("raw.tif").write_bytes(scan.path("raw.tif").read_bytes()[:-1])
    assert export(scan, store, tmp_path / "out", "dng") == 2
    assert "raw.tif" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_raw_frame_is_not_replaced_unasked(
    store: BundleStore, publish_scan: Callable[..., ScanBundle], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scan = publish_scan(store)
    path = tmp_path / f"{scan.scan_id}.dng"
    path.write_text("mine")
    assert export(scan, store, tmp_path, "dng") == 2
    assert "--overwrite" in capsys.readouterr().err
    assert path.read_text() == "mine"
    assert export(scan, store, tmp_path, "dng", "--overwrite") == 0
    assert path.read_bytes().startswith(b"II*")


def test_several_are_exported_by_id_and_by_the_name_of_the_part(
    store: BundleStore,
    scan_record: Callable[..., ScanRecord],
    raw_frame: Callable[..., RawFrame],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    scans = []
    for part in ("valve", "seal", "plate", "plate"):
        frame = raw_frame(3, (64, 96))
        record = msgspec.structs.replace(scan_record(store), shape=frame.shape, annotations=Annotations(part=part))
        scans.append(store.publish_scan(record, lambda folder, frame=frame: write_raw(folder / "raw.tif", frame)))
    command = ["export", "--to", "dng", "--library", str(store.root), "--out"]
    assert main([*command, str(tmp_path / "a"), "valve", scans[1].scan_id]) == 0
    assert {path.stem for path in (tmp_path / "a").iterdir()} == {scan.scan_id for scan in scans[:2]}
    capsys.readouterr()
    assert main([*command, str(tmp_path / "b"), "valve", "plate", "none"]) == 1
    said = capsys.readouterr().err
    assert f"2 scans are of the part plate: name one of {scans[2].scan_id}, {scans[3].scan_id}" in said
    assert "holds no scan 'none'" in said
    assert len(list((tmp_path / "b").iterdir())) == 1
    assert main([*command, str(tmp_path / "c"), "plate"]) == 2
    assert main([*command, str(tmp_path / "c")]) == 2
