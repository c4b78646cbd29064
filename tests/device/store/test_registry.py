"""Calibrations on the device: right place, versions, the way back, and refusals by name."""

import shutil
from pathlib import Path

import msgspec
import pytest

from device.acquisition.capture import CaptureSettings, capture
from device.bundles.calibration import CalibrationBundle
from device.bundles.raw_frame import write_raw
from device.errors import CalibrationMismatch, NoCalibration, RecordError
from device.store.registry import CalibrationRegistry
from device.store.registry_file import content_address
from device.store.store import BundleStore
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
        reference = capture(hardware, CaptureSettings.of_board(hardware))

    def write(directory: Path) -> None:
        for name in bundle.record.files:
            shutil.copyfile(bundle.directory / name, directory / name)
        write_raw(directory / record.reference_file, reference)

    return store.publish_calibration(record, write)


@pytest.fixture
def registry(calibrated: BundleStore, small_twin: BoardProfile) -> CalibrationRegistry:
    return CalibrationRegistry(calibrated, small_twin)


def of_gel(profile: BoardProfile, gel_id: str) -> BoardProfile:
    return msgspec.structs.replace(profile, gel=msgspec.structs.replace(profile.gel, id=gel_id))


def test_versions_count_up_and_a_rollback_goes_one_back(
    registry: CalibrationRegistry, calibrated: BundleStore, hardware: Hardware
) -> None:
    first = calibrated.active_calibration().calibration_id
    second = again(calibrated, hardware).calibration_id
    entry = registry.activate(second)
    assert (entry.version, entry.slot) == (2, "user")
    assert calibrated.active_calibration().calibration_id == second
    assert registry.roll_back().calibration_id == first
    assert calibrated.active_calibration().calibration_id == first
    with pytest.raises(NoCalibration, match="no earlier calibration"):
        registry.roll_back()
    assert [(s.entry.version, s.active) for s in registry.list()] == [(1, True), (2, False)]


def test_switching_gels_switches_the_calibration(
    registry: CalibrationRegistry, calibrated: BundleStore, hardware: Hardware, small_twin: BoardProfile
) -> None:
    own = calibrated.active_calibration().calibration_id
    soft = again(calibrated, hardware, gel_id="soft").calibration_id
    assert CalibrationRegistry(calibrated, of_gel(small_twin, "soft")).switch().calibration_id == soft
    assert calibrated.active_calibration().calibration_id == soft
    assert registry.switch().calibration_id == own
    with pytest.raises(NoCalibration, match=r"gel hard has no calibration.*calibrated gels are soft, twin-gel"):
        CalibrationRegistry(calibrated, of_gel(small_twin, "hard")).switch()


def test_a_stale_one_and_one_of_another_gel_are_refused_by_name(
    calibrated: BundleStore, hardware: Hardware, small_twin: BoardProfile
) -> None:
    own = calibrated.active_calibration().calibration_id
    with pytest.raises(CalibrationMismatch, match=f"{own} is of gel twin-gel, mounted is soft"):
        CalibrationRegistry(calibrated, of_gel(small_twin, "soft")).activate(own)
    red = msgspec.structs.replace(small_twin.lights[0], position_mm=(1.0, -21.0, 12.5))
    moved = msgspec.structs.replace(small_twin, lights=(red, *small_twin.lights[1:]))
    with pytest.raises(CalibrationMismatch, match=f"{own} is stale: made under lights"):
        CalibrationRegistry(calibrated, moved).activate(own)
    with pytest.raises(NoCalibration, match="is stale"):
        CalibrationRegistry(calibrated, moved).switch()
    with pytest.raises(RecordError, match="no calibration nobody-cal"):
        CalibrationRegistry(calibrated, small_twin).activate("nobody-cal")


def test_a_calibration_travels_and_a_foreign_one_is_adopted_only_when_asked(
    registry: CalibrationRegistry, calibrated: BundleStore, tmp_path: Path, small_twin: BoardProfile
) -> None:
    own = calibrated.active_calibration()
    carried = registry.export(own.calibration_id, tmp_path / "stick")
    other = BundleStore(tmp_path / "other", VirtualClock())
    there = CalibrationRegistry(other, small_twin)
    with pytest.raises(CalibrationMismatch, match="was made by instrument"):
        there.import_(carried, "factory")
    entry = there.import_(carried, "factory", adopt=True)
    assert entry.slot == "factory"
    assert entry.content == content_address(own.record)
    assert there.import_(carried, "user", adopt=True) == entry
    assert there.switch() == entry
    other.active_calibration().verify()
    assert other.calibrations().damaged == ()


def test_the_factory_calibration_is_what_a_rollback_ends_at(
    registry: CalibrationRegistry, calibrated: BundleStore, hardware: Hardware, tmp_path: Path, small_twin: BoardProfile
) -> None:
    carried = registry.export(calibrated.active_calibration().calibration_id, tmp_path / "stick")
    user = again(calibrated, hardware)
    other = BundleStore(tmp_path / "other", VirtualClock())
    there = CalibrationRegistry(other, small_twin)
    factory = there.import_(carried, "factory", adopt=True)
    mine = there.import_(registry.export(user.calibration_id, tmp_path / "stick"), "user", adopt=True)
    there.activate(mine.calibration_id)
    assert there.roll_back() == factory
    with pytest.raises(NoCalibration):
        there.roll_back()


def test_a_damaged_folder_is_refused_and_leaves_nothing(
    registry: CalibrationRegistry, calibrated: BundleStore, tmp_path: Path, small_twin: BoardProfile
) -> None:
    carried = registry.export(calibrated.active_calibration().calibration_id, tmp_path / "stick")
    (carried / "reference.tif").write_bytes(b"rot")
    other = BundleStore(tmp_path / "other", VirtualClock())
    with pytest.raises(RecordError, match=r"reference\.tif"):
        CalibrationRegistry(other, small_twin).import_(carried, "user", adopt=True)
    assert other.calibrations().bundles == ()
    assert list((tmp_path / "other" / "calibrations").iterdir()) == []
