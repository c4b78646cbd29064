"""Balls of nearly the stated radius by the whole instrument: the right one passes, others fail."""

import pytest

from device.acquisition.check_press import calibration_ball_bias
from device.acquisition.scanner import Scanner
from device.bundles.check import CheckStandard
from device.instrument.instrument import Instrument
from device.store.store import BundleStore
from hal.hardware import Hardware
from hal.simulator.bench import SimulatedScene
from hal.simulator.surfaces import Sphere
from tests.device.instrument.test_check_standard import checked

PRESSES = ((0.3, (0.6, -0.4)), (0.6, (-1.0, 0.8)))
"""Depth (mm) and place (mm) of presses: shallow ones read too large by the most."""


def ball(radius_mm: float, name: str) -> CheckStandard:
    return CheckStandard(name=name, kind="ball", value_um=1e3 * radius_mm, tolerance_um=2.0)


@pytest.mark.parametrize("radius_mm", [2.0, 2.5, 3.0, 4.0, 5.0])
def test_the_stated_ball_passes_when_it_is_the_first(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore, radius_mm: float
) -> None:
    with Instrument(hardware, calibrated) as instrument:
        for number, (depth_mm, place) in enumerate(PRESSES):
            instrument.set_standard(ball(radius_mm, f"ball {number}"))
            result = checked(instrument, bench, Sphere(radius_mm), depth_mm, place)
            assert result.passed, result.sentence


@pytest.mark.parametrize(("pressed_mm", "stated_mm"), [(2.5, 3.0), (3.0, 2.5), (3.5, 4.0), (4.0, 3.5)])
def test_a_look_alike_fails_when_it_is_the_first(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore, pressed_mm: float, stated_mm: float
) -> None:
    with Instrument(hardware, calibrated) as instrument:
        for number, (depth_mm, place) in enumerate(PRESSES):
            instrument.set_standard(ball(stated_mm, f"ball {number}"))
            result = checked(instrument, bench, Sphere(pressed_mm), depth_mm, place)
            assert not result.passed, result.sentence


def test_the_calibrations_own_balls_read_as_stated(hardware: Hardware, calibrated: BundleStore) -> None:
    with hardware:
        scanner = Scanner(hardware, calibrated)
        bias = calibration_ball_bias(scanner.calibration, scanner.model)
    assert bias is not None
    assert bias.fraction == pytest.approx(1.0, abs=0.03)
    assert 1000.0 < bias.top_um < 1400.0


def test_without_a_press_that_can_be_read_there_is_no_correction(hardware: Hardware, calibrated: BundleStore) -> None:
    with hardware:
        scanner = Scanner(hardware, calibrated)
        for press in scanner.calibration.record.presses:
            scanner.calibration.path(press.file).unlink()
        assert calibration_ball_bias(scanner.calibration, scanner.model) is None
