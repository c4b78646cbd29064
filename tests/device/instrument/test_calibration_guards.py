"""What must not become a calibration: a reference of something pressed, a ball of another radius, a failed check."""

import dataclasses
import re
from typing import Literal

import msgspec
import pytest

from device.acquisition.calibrate import calibrate
from device.acquisition.guided_calibration import CalibrationProgress
from device.errors import CalibrationError, StoreError
from device.instrument.demo_faults import DemoDisk
from device.instrument.events import Failed
from device.instrument.instrument import Instrument
from device.store.store import BundleStore
from hal.board_profile import BoardProfile
from hal.clock import VirtualClock
from hal.hardware import Hardware
from hal.interfaces import OperatorRequest, PressBall
from hal.simulator.bench import SimulatedScene, build
from hal.simulator.hardware import twin_hardware
from hal.simulator.operator import gallery_names, specimen
from hal.simulator.scene import Press


class OtherBall:
    """An operator who presses a ball of another radius than asked for."""

    def __init__(self, hardware: Hardware, radius_mm: float) -> None:
        self._operator = hardware.operator
        self._radius_mm = radius_mm

    def ask(self, request: OperatorRequest) -> None:
        if isinstance(request, PressBall):
            request = dataclasses.replace(request, radius_mm=self._radius_mm)
        self._operator.ask(request)


def guided(instrument: Instrument, stated_mm: float = 3.0) -> CalibrationProgress:
    """The progress once the calibration is over."""
    instrument.start_calibration(stated_mm)
    for _ in range(3000):
        instrument.step()
        progress = instrument.state.guide
        if progress and progress.is_over:
            return progress
    raise AssertionError("the calibration does not end")


@pytest.mark.parametrize("name", gallery_names())
def test_a_reference_with_something_on_the_gel_is_asked_for_again(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore, name: str
) -> None:
    with Instrument(hardware, calibrated) as instrument:
        instrument.start_calibration(3.0)
        instrument.step()
        bench.place(Press(specimen(name).surface, (0.5, -0.5), 0.2, specimen(name).indentation_mm))
        instrument.press()
        for _ in range(3):
            instrument.step()
        progress = instrument.state.guide
        assert progress is not None
        assert progress.phase == "reference"
        assert "touches the gel" in progress.complaint or "touched" in progress.complaint


def test_a_ball_of_another_radius_is_measured_and_refused(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore
) -> None:
    before = calibrated.active_calibration().calibration_id
    wrong = dataclasses.replace(hardware, operator=OtherBall(hardware, 2.5))
    with Instrument(wrong, calibrated) as instrument:
        progress = guided(instrument)
        assert progress.phase == "failed"
        assert "ball's radius is 2." in progress.instruction
        assert progress.accepted < progress.wanted
        assert instrument.state.calibration.calibration_id == before
    assert calibrated.active_calibration().calibration_id == before
    assert len(calibrated.calibrations().bundles) == 1


def test_the_stated_ball_agrees_with_the_last_calibration(hardware: Hardware, calibrated: BundleStore) -> None:
    before = calibrated.active_calibration().calibration_id
    with Instrument(hardware, calibrated) as instrument:
        progress = guided(instrument)
        assert progress.phase == "passed", progress.instruction
        assert all(check.passed for check in progress.checks)
        assert "ball radius off" in progress.checks[-1].name
        assert instrument.state.calibration.calibration_id != before


def with_skin(profile: BoardProfile, skin: Literal["diffuse", "flake", "sharp-flake"]) -> Hardware:
    """A small twin with that skin and nothing stored."""
    assert profile.twin is not None
    twin = msgspec.structs.replace(profile.twin, skin=skin)
    clock = VirtualClock(start_ns=5_000_000_000, wall_start_s=1_000.0)
    return twin_hardware(build(msgspec.structs.replace(profile, twin=twin), clock))


@pytest.mark.parametrize("skin", ["diffuse", "flake", "sharp-flake"])
@pytest.mark.parametrize(("pressed_mm", "stated_mm"), [(2.5, 3.0), (3.0, 2.5), (3.5, 3.0)])
def test_the_first_calibration_measures_its_ball_by_shadows_and_refuses_a_wrong_one(
    small_twin: BoardProfile,
    store: BundleStore,
    skin: Literal["diffuse", "flake", "sharp-flake"],
    pressed_mm: float,
    stated_mm: float,
) -> None:
    hardware = with_skin(small_twin, skin)
    wrong = dataclasses.replace(hardware, operator=OtherBall(hardware, pressed_mm))
    with Instrument(wrong, store) as instrument:
        progress = guided(instrument, stated_mm)
        assert progress.phase == "failed"
        measured = re.search(r"ball's radius is ([0-9.]+) mm, not", progress.instruction)
        assert measured, progress.instruction
        assert float(measured[1]) == pytest.approx(pressed_mm, rel=0.05)
        assert instrument.state.calibration.calibration_id is None
    assert store.calibrations().bundles == ()


@pytest.mark.parametrize("skin", ["diffuse", "flake"])
def test_the_first_calibration_accepts_the_stated_ball(
    small_twin: BoardProfile, store: BundleStore, skin: Literal["diffuse", "flake"]
) -> None:
    with Instrument(with_skin(small_twin, skin), store) as instrument:
        progress = guided(instrument)
        assert progress.phase == "passed", progress.instruction
    assert all(check.passed for check in progress.checks)
    (radius,) = [check for check in progress.checks if "radius" in check.name]
    assert radius.value < 0.03


def test_the_command_refuses_a_wrong_ball_by_its_measured_radius(hardware: Hardware, store: BundleStore) -> None:
    wrong = dataclasses.replace(hardware, operator=OtherBall(hardware, 2.5))
    with wrong, pytest.raises(CalibrationError, match=r"ball's radius is 2\.\d\d mm, not 3 mm"):
        calibrate(wrong, store, 3.0, lambda _: None)
    assert store.calibrations().bundles == ()


def test_a_calibration_that_the_disk_has_no_room_for_is_refused_before_the_first_push(
    hardware: Hardware, calibrated: BundleStore
) -> None:
    disk = DemoDisk(calibrated.root)
    store = BundleStore(calibrated.root, hardware.clock, boot_id="b0075e1f", statvfs=disk)
    disk.fill(on=True)
    with Instrument(hardware, store) as instrument:
        instrument.start_calibration(3.0)
        instrument.step()
        assert instrument.state.guide is None
        failed = [event.sentence for event in instrument.take_events() if isinstance(event, Failed)]
        assert any("no room for a calibration" in sentence for sentence in failed), failed
    with pytest.raises(StoreError, match="no room for a calibration"):
        calibrate(hardware, store, 3.0, lambda line: pytest.fail(f"something is asked for: {line}"))
