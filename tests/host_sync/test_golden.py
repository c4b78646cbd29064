"""Bundles of every released version are read for ever, and mean what they meant: `tests/golden/README.md`."""

from __future__ import annotations

import shutil
import zlib
from pathlib import Path

import numpy as np
import pytest
import rawpy
import tifffile

from device.bundles.bundle import is_receipted
from device.imaging.flat_field import bin_bayer
from device.inverse_map.model import read_model
from device.quick_look.solver import QuickLookModel, quick_look
from device.store.store import BundleStore
from hal.clock import VirtualClock
from host_sync.export.raw_scan import export_raw
from host_sync.library.index import Query, search
from host_sync.library.library import Library
from host_sync.library.verification import verify_library
from host_sync.offload.pull import pull
from host_sync.offload.source import DirectorySource

GOLDEN = Path(__file__).parent.parent / "golden"
COUNTS_CRC32 = {"record-1": 3667700596}
SCANS = {"record-1": "rgd3faa81c-b0075e1f-000002"}


@pytest.fixture(params=sorted(SCANS))
def version(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def golden(version: str, tmp_path: Path) -> Path:
    """A copy, as starting a store prepares its folders."""
    return Path(shutil.copytree(GOLDEN / version, tmp_path / "golden"))


def test_every_golden_version_is_tried() -> None:
    assert {path.name for path in GOLDEN.iterdir() if path.is_dir()} == set(SCANS)
    assert sum(path.stat().st_size for path in GOLDEN.rglob("*") if path.is_file()) <= 300_000


def test_the_device_reads_it(golden: Path, version: str) -> None:
    store = BundleStore(golden, VirtualClock(), boot_id="b0071d99")
    (scan,) = store.scans().bundles
    assert (scan.scan_id, store.device_id) == (SCANS[version], SCANS[version].split("-")[0])
    scan.verify()
    frame = scan.raw_frame()
    assert zlib.crc32(frame.mosaic.astype("<u2").tobytes()) == COUNTS_CRC32[version]
    assert (frame.bayer_order, frame.shape) == ("RGGB", (90, 120))
    calibration = store.active_calibration()
    calibration.verify()
    assert scan.record.calibration_id == calibration.calibration_id
    assert [calibration.press_frame(press).shape for press in calibration.record.presses] == [(90, 120)] * 2
    assert is_receipted(golden, "scans", scan.scan_id, (scan.directory / "scan.json").read_bytes())
    assert store.make_room(1 << 62) == [scan.scan_id]
    assert store.next_identity("scans").counter == 3


def test_its_calibration_still_gives_the_heights_that_the_device_saw(golden: Path) -> None:
    store = BundleStore(golden, VirtualClock(), boot_id="b0071d99")
    (scan,) = store.scans().bundles
    calibration = store.active_calibration()
    inverse_map = read_model(calibration.path(calibration.record.model_files[0]))
    model = QuickLookModel.prepare(calibration.reference(), inverse_map, calibration.record.pixel_pitch_um)
    seen_um = tifffile.imread(scan.path("quick-look-um.tif"))
    now_um = quick_look(bin_bayer(scan.raw_frame(), model.binning), model).height.z_um
    assert now_um.shape == seen_um.shape
    assert np.ptp(seen_um) > 100.0
    assert np.sqrt(np.mean((now_um - seen_um) ** 2)) < 0.02 * np.ptp(seen_um)


def test_the_workstation_pulls_finds_and_exports_it(golden: Path, version: str, tmp_path: Path) -> None:
    library = Library(tmp_path / "library")
    assert pull(DirectorySource(golden), library).complete
    assert (verify_library(library).sound, verify_library(library).damaged) == (2, ())
    (hit,) = search(library, Query(job="golden", verdict="good"))
    assert hit.scan_id == SCANS[version]
    scan = library.find(hit.scan_id)
    with rawpy.imread(str(export_raw(scan, "dng", tmp_path))) as raw:
        assert np.array_equal(raw.raw_image, scan.raw_frame().mosaic)
    assert library.calibration_for(scan).reference().shape == (90, 120)
