"""Scans that are deleted, brought back, taken again and numbered, by the whole instrument."""

import errno
import os
from pathlib import Path

import pytest
from msgspec import structs

from device.bundles.scan import Annotations
from device.errors import RecordError, StoreError
from device.instrument.events import Failed, Info, ScanFinished
from device.instrument.history import next_part
from device.instrument.instrument import Instrument
from device.store.deletion import purge_deleted
from device.store.store import BundleStore
from hal.hardware import Hardware
from hal.interfaces import ButtonPress
from hal.simulator.bench import SimulatedScene
from hal.simulator.scene import Press
from hal.simulator.surfaces import Sphere


def scanned(instrument: Instrument, bench: SimulatedScene, depth_mm: float = 0.5) -> ScanFinished:
    """One push on a ball, which is then lifted."""
    for _ in range(24):
        instrument.step()
    bench.place(Press(Sphere(4.0), (0.0, 0.0), 0.0, depth_mm))
    bench.schedule_button(ButtonPress(bench.clock.monotonic_ns() + 100_000_000, 0.05))
    for _ in range(12):
        instrument.step()
    bench.place(None)
    for _ in range(600):
        instrument.step()
        for event in instrument.take_events():
            if isinstance(event, ScanFinished):
                return event
    raise AssertionError("no scan came of the push")


def numbers(instrument: Instrument) -> list[int]:
    return [entry.counter for entry in instrument.history().scans]


def test_the_first_scan_is_number_one_and_calibrations_take_no_numbers(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore
) -> None:
    with Instrument(hardware, calibrated) as instrument:
        scanned(instrument, bench)
        assert calibrated.next_identity("calibrations").counter == 2
        scanned(instrument, bench)
        assert numbers(instrument) == [2, 1]


def test_a_deleted_scan_comes_back_until_power_off(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore
) -> None:
    instrument = Instrument(hardware, calibrated)
    with instrument:
        first, second = scanned(instrument, bench), scanned(instrument, bench)
        instrument.mark(first.scan_id, "good", "keep")
        for scan in (first, second):
            instrument.delete(scan.scan_id)
        assert numbers(instrument) == []
        assert instrument.state.scans_stored == 0
        assert instrument.undo_delete() == second.scan_id
        assert instrument.undo_delete() == first.scan_id
        with pytest.raises(RecordError, match="no scan was deleted"):
            instrument.undo_delete()
        kept = instrument.history().scans
        assert [entry.counter for entry in kept] == [2, 1]
        assert kept[1].mark is not None
        assert kept[1].mark.note == "keep"
        for bundle in calibrated.scans().bundles:
            bundle.verify()
        instrument.delete(first.scan_id)
        with pytest.raises(RecordError, match="no longer there"):
            instrument.delete(first.scan_id)
        instrument.power_off()
        instrument.step()
        with pytest.raises(RecordError):
            instrument.undo_delete()
    assert [bundle.scan_id for bundle in calibrated.scans().bundles] == [second.scan_id]
    assert list((calibrated.root / "deleted").iterdir()) == []
    assert not list((calibrated.root / "marks").glob(f"{first.scan_id}*"))


def test_what_an_earlier_start_deleted_is_gone_and_its_room_is_free(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore
) -> None:
    with Instrument(hardware, calibrated) as instrument:
        instrument.delete(scanned(instrument, bench).scan_id)
    assert [path.name for path in (calibrated.root / "deleted").iterdir()]
    with pytest.raises(RecordError):
        Instrument(hardware, calibrated).undo_delete()
    assert list((calibrated.root / "deleted").iterdir()) == []


def test_a_retake_replaces_the_last_scan_and_keeps_its_part(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore
) -> None:
    with Instrument(hardware, calibrated) as instrument:
        instrument.retake()
        (refused,) = [event.sentence for event in instrument.take_events() if isinstance(event, Failed)]
        assert refused.startswith("there is no scan to take again")
        instrument.set_sticky(Annotations(job="lids", part="A-09"))
        instrument.set_settings(structs.replace(instrument.state.settings, number_parts=True))
        first = scanned(instrument, bench)
        assert instrument.state.sticky.part == "A-10"
        instrument.retake()
        assert instrument.state.replaces is not None
        assert instrument.state.replaces.scan_id == first.scan_id
        scanned(instrument, bench)
        assert instrument.state.replaces is None
        scanned(instrument, bench)
        kept = [(entry.counter, entry.annotations.part) for entry in instrument.history().scans]
        assert kept == [(3, "A-10"), (2, "A-09")]
        assert instrument.state.sticky.part == "A-11"
        assert instrument.undo_delete() == first.scan_id
        assert numbers(instrument) == [3, 2, 1]


def test_a_full_store_frees_a_deleted_scan_for_a_press_and_not_before(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    gone = calibrated.root / "deleted"
    with Instrument(hardware, calibrated) as instrument:
        first = scanned(instrument, bench)
        instrument.delete(first.scan_id)
        monkeypatch.setattr(BundleStore, "scans_left", lambda *_: 0 if any(gone.iterdir()) else 7)
        bench.clock.sleep(6.0)
        instrument.step()
        assert [path.name for path in gone.iterdir()] == [first.scan_id]
        assert (instrument.state.scans_left or 0) > 0
        scanned(instrument, bench)
        assert list(gone.iterdir()) == []
        assert numbers(instrument) == [2]


def test_an_undo_that_the_disk_refused_is_tried_again(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: object) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    with Instrument(hardware, calibrated) as instrument:
        first = scanned(instrument, bench)
        instrument.delete(first.scan_id)
        with monkeypatch.context() as patch:
            patch.setattr(Path, "rename", refused)
            with pytest.raises(StoreError, match="cannot be brought back"):
                instrument.undo_delete()
        assert instrument.undo_delete() == first.scan_id
        instrument.delete(first.scan_id)
        purge_deleted(calibrated.root)
        with pytest.raises(RecordError, match="no longer there"):
            instrument.undo_delete()
        with pytest.raises(RecordError, match="no scan was deleted"):
            instrument.undo_delete()


def test_a_retake_that_is_no_better_keeps_both(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore
) -> None:
    with Instrument(hardware, calibrated) as instrument:
        scanned(instrument, bench)
        instrument.retake()
        bench.faults.dimmed = {"green": 0.4}
        again = scanned(instrument, bench)
        assert again.verdict.level == "retake"
        assert numbers(instrument) == [2, 1]


def test_a_worse_retake_keeps_the_better_scan(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore
) -> None:
    with Instrument(hardware, calibrated) as instrument:
        first = scanned(instrument, bench)
        assert first.verdict.level == "good"
        instrument.retake()
        again = scanned(instrument, bench, depth_mm=0.02)
        assert again.verdict.level == "doubtful"
        assert numbers(instrument) == [2, 1]


def test_what_was_deleted_is_not_taken_again(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore
) -> None:
    with Instrument(hardware, calibrated) as instrument:
        first = scanned(instrument, bench)
        instrument.retake()
        instrument.delete(first.scan_id)
        assert instrument.state.replaces is None
        instrument.take_events()
        instrument.retake()
        (refused,) = [event.sentence for event in instrument.take_events() if isinstance(event, Failed)]
        assert refused.startswith("there is no scan to take again")


def test_a_press_that_is_not_stored_gives_its_number_back(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore, tmp_path: Path
) -> None:
    with Instrument(hardware, calibrated) as instrument:
        instrument.set_sticky(Annotations(part="7"))
        instrument.set_settings(structs.replace(instrument.state.settings, number_parts=True))
        (calibrated.root / "scans").rename(tmp_path / "away")
        (calibrated.root / "scans").write_text("in the way")
        with pytest.raises(AssertionError):
            scanned(instrument, bench)
        assert instrument.state.sticky.part == "7"
        (calibrated.root / "scans").unlink()
        (tmp_path / "away").rename(calibrated.root / "scans")


@pytest.mark.parametrize(
    ("part", "following"),
    [("A-08", "A-09"), ("A-99", "A-100"), ("lid", "lid-2"), ("12/3 left", "12/4 left"), ("7", "8"), ("rev2b", "rev3b")],
)
def test_the_last_number_of_a_part_grows(part: str, following: str) -> None:
    assert next_part(part) == following


def test_undo_and_retake_are_said(bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore) -> None:
    with Instrument(hardware, calibrated) as instrument:
        scanned(instrument, bench)
        instrument.retake()
        instrument.retake()
        said = [event.sentence for event in instrument.take_events() if isinstance(event, Info)]
        assert said == ["Press again: the next scan replaces #1.", "The next press is one more scan."]
        assert instrument.state.replaces is None
