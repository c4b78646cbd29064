"""What must not become a calibration: a reference of something pressed, a ball of another radius, a failed check."""

import dataclasses

import pytest

from device.acquisition.guided_calibration import CalibrationProgress
from device.instrument.instrument import Instrument
from device.store.store import BundleStore
from hal.hardware import Hardware
from hal.interfaces import OperatorRequest, PressBall
from hal.simulator.bench import SimulatedScene
from hal.simulator.gallery import gallery_names, specimen
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


def guided(instrument: Instrument) -> CalibrationProgress:
    """The progress once the calibration is over."""
    instrument.start_calibration(3.0)
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
        assert not all(check.passed for check in progress.checks)
        assert "ball's radius is 2." in progress.instruction
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
