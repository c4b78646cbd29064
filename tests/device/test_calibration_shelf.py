"""Calibrations on the device: right place, versions, the way back, and refusals by name."""

import shutil
from pathlib import Path

import msgspec
import pytest

from device.bundle_store import BundleStore
from device.calibration_address import content_address
from device.calibration_bundle import CalibrationBundle
from device.calibration_shelf import CalibrationShelf
from device.errors import CalibrationMismatch, NoCalibration, RecordError
from device.raw_file import write_raw
from device.scanning.capture import CapturePlan, capture
from hal.board_profile import BoardProfile
from hal.clock import VirtualClock
from hal.hardware import Hardware
from hal.interfaces import LiftOff


def again(store: BundleStore, hardware: Hardware, **changes: object) -> CalibrationBundle:
    """One calibration more, like the store's own, with a reference of its own."""
    bundle = store.active_calibration()
    record = msgspec.structs.replace(bundle.record, identity=store.next_identity("calibrations"), files={}, **changes)
    with hardware:
        hardware.operator.ask(LiftOff())
        reference = capture(hardware, CapturePlan.of_board(hardware))

    def write(directory: Path) -> None:
        for name in bundle.record.files:
            shutil.copyfile(bundle.directory / name, directory / name)
        write_raw(directory / record.reference_file, reference)

    return store.publish_calibration(record, write)


@pytest.fixture
def shelf(calibrated: BundleStore, small_twin: BoardProfile) -> CalibrationShelf:
    return CalibrationShelf(calibrated, small_twin)


def of_gel(profile: BoardProfile, gel_id: str) -> BoardProfile:
    return msgspec.structs.replace(profile, gel=msgspec.structs.replace(profile.gel, id=gel_id))


def test_versions_count_up_and_a_rollback_goes_one_back(
    shelf: CalibrationShelf, calibrated: BundleStore, hardware: Hardware
) -> None:
    first = calibrated.active_calibration().calibration_id
    second = again(calibrated, hardware).calibration_id
    entry = shelf.put_in_force(second)
    assert (entry.version, entry.slot) == (2, "user")
    assert calibrated.active_calibration().calibration_id == second
    assert shelf.roll_back().calibration_id == first
    assert calibrated.active_calibration().calibration_id == first
    with pytest.raises(NoCalibration, match="no earlier calibration"):
        shelf.roll_back()
    assert [(s.entry.version, s.in_force) for s in shelf.shelved()] == [(1, True), (2, False)]


def test_switching_gels_switches_the_calibration(
    shelf: CalibrationShelf, calibrated: BundleStore, hardware: Hardware, small_twin: BoardProfile
) -> None:
    own = calibrated.active_calibration().calibration_id
    soft = again(calibrated, hardware, gel_id="soft").calibration_id
    assert CalibrationShelf(calibrated, of_gel(small_twin, "soft")).switch().calibration_id == soft
    assert calibrated.active_calibration().calibration_id == soft
    assert shelf.switch().calibration_id == own
    with pytest.raises(NoCalibration, match=r"gel hard has no calibration.*calibrated are soft, twin-gel"):
        CalibrationShelf(calibrated, of_gel(small_twin, "hard")).switch()


def test_a_stale_one_and_one_of_another_gel_are_refused_by_name(
    calibrated: BundleStore, hardware: Hardware, small_twin: BoardProfile
) -> None:
    own = calibrated.active_calibration().calibration_id
    with pytest.raises(CalibrationMismatch, match=f"{own} is of gel twin-gel, mounted is soft"):
        CalibrationShelf(calibrated, of_gel(small_twin, "soft")).put_in_force(own)
    red = msgspec.structs.replace(small_twin.lights[0], position_mm=(1.0, -21.0, 12.5))
    moved = msgspec.structs.replace(small_twin, lights=(red, *small_twin.lights[1:]))
    with pytest.raises(CalibrationMismatch, match=f"{own} is stale: made under lights"):
        CalibrationShelf(calibrated, moved).put_in_force(own)
    with pytest.raises(NoCalibration, match="is stale"):
        CalibrationShelf(calibrated, moved).switch()
    with pytest.raises(RecordError, match="no calibration nobody-cal"):
        CalibrationShelf(calibrated, small_twin).put_in_force("nobody-cal")


def test_a_calibration_travels_and_a_foreign_one_is_adopted_only_when_asked(
    shelf: CalibrationShelf, calibrated: BundleStore, tmp_path: Path, small_twin: BoardProfile
) -> None:
    own = calibrated.active_calibration()
    carried = shelf.give_out(own.calibration_id, tmp_path / "stick")
    other = BundleStore(tmp_path / "other", VirtualClock())
    there = CalibrationShelf(other, small_twin)
    with pytest.raises(CalibrationMismatch, match="was made by instrument"):
        there.take_in(carried, "factory")
    entry = there.take_in(carried, "factory", adopt=True)
    assert entry.slot == "factory"
    assert entry.content == content_address(own.record)
    assert there.take_in(carried, "user", adopt=True) == entry
    assert there.switch() == entry
    other.active_calibration().verify()
    assert other.calibrations().damaged == ()


def test_the_factory_calibration_is_what_a_rollback_ends_at(
    shelf: CalibrationShelf, calibrated: BundleStore, hardware: Hardware, tmp_path: Path, small_twin: BoardProfile
) -> None:
    carried = shelf.give_out(calibrated.active_calibration().calibration_id, tmp_path / "stick")
    user = again(calibrated, hardware)
    other = BundleStore(tmp_path / "other", VirtualClock())
    there = CalibrationShelf(other, small_twin)
    factory = there.take_in(carried, "factory", adopt=True)
    mine = there.take_in(shelf.give_out(user.calibration_id, tmp_path / "stick"), "user", adopt=True)
    there.put_in_force(mine.calibration_id)
    assert there.roll_back() == factory
    with pytest.raises(NoCalibration):
        there.roll_back()


def test_a_damaged_folder_is_refused_and_leaves_nothing(
    shelf: CalibrationShelf, calibrated: BundleStore, tmp_path: Path, small_twin: BoardProfile
) -> None:
    carried = shelf.give_out(calibrated.active_calibration().calibration_id, tmp_path / "stick")
    (carried / "reference.tif").write_bytes(b"rot")
    other = BundleStore(tmp_path / "other", VirtualClock())
    with pytest.raises(RecordError, match=r"reference\.tif"):
        CalibrationShelf(other, small_twin).take_in(carried, "user", adopt=True)
    assert other.calibrations().bundles == ()
    assert list((tmp_path / "other" / "calibrations").iterdir()) == []
