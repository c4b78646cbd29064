"""A handheld's failed check of its check standard is a doubt of the results since the last good one."""

import shutil
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest

from device.bundles.check import CHECK_FILE, CheckRecord
from device.bundles.record import encode_record
from device.bundles.scan import LightFaultRecord, ScanBundle, ScanRecord, VerdictRecord
from device.store.store import BundleStore
from host_sync.results.doubts import quick_look_doubts, result_doubts
from host_sync.results.record import ResultRecord

CALIBRATION = "rg-cal"


def check_of(record: ScanRecord, measured_um: float) -> CheckRecord:
    return CheckRecord(
        scan_id=record.scan_id,
        counter=record.identity.counter,
        checked=record.wall_time,
        calibration_id=CALIBRATION,
        name="ball 3",
        kind="ball",
        value_um=3000.0,
        limit_um=300.0,
        measured_um=measured_um,
    )


@pytest.fixture
def library(store: BundleStore, scan_record: Callable[..., ScanRecord], raw_frame: Callable[..., object]) -> list[str]:
    """Ids of five scans: a good check, a scan, a failed check, a scan that another calibration was used for, a scan."""
    ids = []
    for number in range(5):
        record = scan_record(store, "other-cal" if number == 3 else CALIBRATION)
        check = check_of(record, 3050.0 if number == 0 else 3500.0) if number in (0, 2) else None
        record = msgspec.structs.replace(record, check=check)

        def write(directory: Path, check: CheckRecord | None = check) -> None:
            (directory / "raw.tif").write_bytes(b"x")
            if check:
                (directory / CHECK_FILE).write_bytes(encode_record(check))

        ids.append(ScanBundle(store.publish_scan(record, write).directory, record).scan_id)
    return ids


def test_scans_since_the_last_good_check_are_doubtful(store: BundleStore, library: list[str]) -> None:
    found = []
    for scan_id in library:
        folder = store.root / "scans" / scan_id / "results" / "one"
        record = ResultRecord(name="one", rows=4, columns=4, pixel_pitch_um=1.0, scan_id=scan_id, height_zero="skin")
        found.append([doubt.sentence for doubt in result_doubts(folder, record)])
    assert found[0] == []
    assert found[3] == []
    for number in (1, 2, 4):
        (sentence,) = found[number]
        assert sentence.startswith("failed check standard: check of ball 3 FAILED: 3.5 mm, 3 ± 0.3 mm expected")


def test_a_scan_that_was_taken_again_says_so_where_the_newer_one_is(
    store: BundleStore, scan_record: Callable[..., ScanRecord]
) -> None:
    def published(replaces: str | None) -> Path:
        record = msgspec.structs.replace(scan_record(store, CALIBRATION), replaces=replaces)
        return store.publish_scan(record, lambda folder: (folder / "raw.tif").write_bytes(b"x")).directory

    old, lonely = published(None), published("rg-gone-7")
    assert quick_look_doubts(old) == ()
    newer = published(old.name)
    (sentence,) = (doubt.sentence for doubt in quick_look_doubts(old))
    assert sentence == f"replaced scan: it was taken again as {newer.name}"
    record = ResultRecord(name="one", rows=4, columns=4, pixel_pitch_um=1.0, scan_id=old.name, height_zero="skin")
    assert [doubt.kind for doubt in result_doubts(old / "results" / "one", record)] == ["replaced scan"]
    assert quick_look_doubts(newer) == quick_look_doubts(lonely) == ()
    shutil.rmtree(newer)
    assert quick_look_doubts(old) == ()


def test_a_quick_look_has_the_doubts_of_its_scan(
    store: BundleStore, library: list[str], scan_record: Callable[..., ScanRecord]
) -> None:
    folders = [store.root / "scans" / scan_id for scan_id in library]
    assert [len(quick_look_doubts(folder)) for folder in folders] == [0, 1, 1, 0, 1]
    record = msgspec.structs.replace(
        scan_record(store, "other-cal"),
        verdict=VerdictRecord(level="doubtful", reason="it moved"),
        light_faults=(LightFaultRecord(light="red", kind="open"),),
    )
    scan = store.publish_scan(record, lambda folder: (folder / "raw.tif").write_bytes(b"x"))
    assert [doubt.sentence for doubt in quick_look_doubts(scan.directory)] == [
        "drifted light: the light driver reported that red is open",
        "reconstruction: the handheld's verdict is doubtful: it moved",
    ]
    certificate = store.root / "calibrations" / "other-cal" / "results" / "0.1.0-abc" / "certificate.json"
    certificate.parent.mkdir(parents=True)
    specimens = [{"name": "step 100", "agrees": False}]
    content = {"calibration_id": "abc", "verdict": "does not agree", "specimens": specimens}
    certificate.write_bytes(msgspec.json.encode(content))
    assert "the instrument does not agree with step 100" in quick_look_doubts(scan.directory)[0].sentence
