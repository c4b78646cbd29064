"""Scans copied to a USB stick by the whole instrument: verified there, receipted, and damage found."""

from pathlib import Path

import pytest

from device.bundles.scan import read_scan
from device.errors import StoreError
from device.instrument.instrument import Instrument
from device.store.deletion import acknowledged_scans
from device.store.store import BundleStore
from device.store.transfers import find_stick
from hal.hardware import Hardware
from hal.simulator.bench import SimulatedScene
from tests.device.instrument.test_scan_keeping import scanned


@pytest.fixture
def stick(tmp_path: Path) -> Path:
    folder = tmp_path / "media" / "blue stick"
    folder.mkdir(parents=True)
    return folder


def mounts_of(tmp_path: Path, *sticks: Path) -> Path:
    """The system's list of mounted disks."""
    path = tmp_path / "mounts"
    places = [str(one).replace(" ", "\\040") for one in sticks]
    path.write_text("\n".join(["/dev/root / ext4 rw 0 0", *(f"/dev/sda1 {place} vfat rw 0 0" for place in places)]))
    return path


def test_a_stick_is_found_where_it_is_mounted(tmp_path: Path, stick: Path) -> None:
    roots = (f"{tmp_path}/media/",)
    assert find_stick(mounts_of(tmp_path, stick), roots) == stick
    with pytest.raises(StoreError, match="no USB stick is mounted"):
        find_stick(mounts_of(tmp_path), roots)
    other = stick.parent / "other"
    other.mkdir()
    with pytest.raises(StoreError, match="2 sticks are mounted"):
        find_stick(mounts_of(tmp_path, stick, other), roots)


def test_scans_are_copied_verified_and_receipted_and_damage_is_mended(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore, stick: Path
) -> None:
    with Instrument(hardware, calibrated, stick=lambda: stick) as instrument:
        first, second = scanned(instrument, bench), scanned(instrument, bench)
        assert not any(entry.offloaded for entry in instrument.history().scans)
        outcome = instrument.export_to_stick()
        assert outcome.sentence.startswith("2 of 2 scans are verified on the stick, 2 copied now")
        assert all(entry.offloaded for entry in instrument.history().scans)
        folder = stick / f"retrograph-{calibrated.device_id}"
        for scan in (first, second):
            read_scan(folder / "scans" / scan.scan_id).verify()
        assert [path.name for path in (folder / "calibrations").iterdir()] == [first_calibration(calibrated)]
        raw = folder / "scans" / first.scan_id / "raw.tif"
        data = bytearray(raw.read_bytes())
        data[len(data) // 2] ^= 1
        raw.write_bytes(data)
        assert instrument.export_to_stick().copied == 1
        read_scan(folder / "scans" / first.scan_id).verify()
        assert instrument.export_to_stick().copied == 0
    assert {scan.scan_id for scan in acknowledged_scans(calibrated.root)} == {first.scan_id, second.scan_id}


def test_a_scan_that_is_damaged_on_the_instrument_gets_no_receipt(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore, stick: Path
) -> None:
    with Instrument(hardware, calibrated, stick=lambda: stick) as instrument:
        scan = scanned(instrument, bench)
        (calibrated.root / "scans" / scan.scan_id / "raw.tif").write_bytes(b"no frame")
        outcome = instrument.export_to_stick()
        assert outcome.verified == 0
        assert "raw.tif" in outcome.sentence
        assert not instrument.history().scans[0].offloaded
        assert not list((stick / f"retrograph-{calibrated.device_id}" / "scans").iterdir())


def first_calibration(store: BundleStore) -> str:
    return store.calibrations().bundles[0].calibration_id
