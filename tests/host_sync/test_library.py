from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from device.bundle_store import BundleStore
from device.calibration_bundle import CalibrationBundle
from device.scan_bundle import ScanBundle
from host_sync.errors import LibraryError, MissingCalibration, NoSuchBundle
from host_sync.library import Library

PublishScan = Callable[..., ScanBundle]


@pytest.fixture
def library(store: BundleStore) -> Library:
    """A store has a library's folders, so that it serves as one."""
    return Library(store.root)


def test_a_scan_answers_to_a_unique_beginning_or_end(
    store: BundleStore, library: Library, publish_scan: PublishScan
) -> None:
    first, second = publish_scan(store), publish_scan(store)
    assert library.find(first.scan_id) == first
    assert library.find(second.scan_id[-2:]) == second
    assert library.find(first.scan_id[: len(first.scan_id)]) == first
    with pytest.raises(NoSuchBundle, match=r"the id of 2 scans, give more of it: .*000001, .*000002"):
        library.find(first.scan_id[:4])
    for absent in ("zzz", "", "../scans"):
        with pytest.raises(NoSuchBundle, match="holds no scan"):
            library.find(absent)


def test_the_calibration_in_force_at_the_press_is_found(
    store: BundleStore,
    library: Library,
    publish_scan: PublishScan,
    publish_calibration: Callable[[BundleStore], CalibrationBundle],
) -> None:
    calibration = publish_calibration(store)
    scan = publish_scan(store, calibration.calibration_id)
    assert library.calibration_for(scan) == calibration
    assert library.find_calibration(calibration.calibration_id[:-1]) == calibration
    with pytest.raises(MissingCalibration, match="without a calibration"):
        library.calibration_for(publish_scan(store))
    with pytest.raises(MissingCalibration, match="needs calibration gone-1-cal"):
        library.calibration_for(publish_scan(store, "gone-1-cal"))


def test_results_stand_beside_the_scan_and_disturb_nothing(
    store: BundleStore, library: Library, publish_scan: PublishScan
) -> None:
    scan = publish_scan(store)
    folder = library.result_folder(scan, "0.1.0", "c0ffee")
    assert folder == scan.directory / "results" / "0.1.0-c0ffee"
    assert library.results(scan) == ()
    folder.mkdir(parents=True)
    assert library.results(scan) == (folder,)
    library.find(scan.scan_id).verify()
    with pytest.raises(LibraryError, match="cannot name a folder"):
        library.result_folder(scan, "0.1.0", "../../up")


def test_an_absent_library_is_told(tmp_path: Path) -> None:
    with pytest.raises(LibraryError, match="there is no library"):
        Library(tmp_path / "absent").scans()
