"""Lamps that drift between presses and from calibration to scan, from frames to height map."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from near_lamps import RADIUS_PX, SHAPE, balls, press_px

from device.errors import CalibrationMismatch
from device.imaging.flat_field import LinearFrame
from host_sync.calibration.balls import PressFrame
from host_sync.calibration.calibrate import Calibration, calibrate
from host_sync.reconstruction.pipeline import Reconstruction, reconstruct
from tests.apparatus.light_ring import lit_by_ring

DRIFT = np.array([0.97, 1.0, 1.01], np.float32)
BALL = replace(balls()[5][0], column=170.0, row=120.0)


PRESSES = (1.0 + 0.015 * np.random.default_rng(4).standard_normal((len(balls()), 3))).astype(np.float32)
"""Brightness of each lamp in each press: they drift, too."""

BALANCE = np.array([1.1, 0.95, 1.3], np.float32)
BALANCES = (BALANCE ** np.linspace(-0.5, 1.0, len(balls()))[:, None]).astype(np.float32)
"""Brightness of each lamp in a scan, and in each press, of a camera that balances white by itself."""


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    return calibrated(PRESSES)


def calibrated(brightness: np.ndarray) -> Calibration:
    """Return the calibration of presses whose lamps have this brightness."""
    presses = [
        PressFrame(f"press-{number:02d}", under(factors, lit_by_ring(press_px(*ball), 3, number)), RADIUS_PX)
        for number, (ball, factors) in enumerate(zip(balls(), brightness, strict=True))
    ]
    return calibrate(presses, lit_by_ring(np.zeros(SHAPE), 3, 99), 20.0)


def under(factors: np.ndarray, frame: LinearFrame) -> LinearFrame:
    return LinearFrame(np.asarray(frame.rgb * factors, np.float32), frame.clipped)


def scan(calibration: Calibration, drift: np.ndarray) -> Reconstruction:
    frame = lit_by_ring(press_px(BALL, 15.0), 3, 200)
    return reconstruct(under(drift, frame), calibration, "scan")


def drift_checks(found: Reconstruction) -> list[float | None]:
    return [check.value for check in found.frame_checks if check.name == "light drift"]


@pytest.mark.slow
def test_drift_is_taken_out_of_heights_and_reported(calibration: Calibration) -> None:
    steady, drifted = scan(calibration, np.ones(3)), scan(calibration, DRIFT)
    without = scan(replace(calibration, skin_at_rest=None), DRIFT)
    moved_um = np.abs(without.height.z_um - steady.height.z_um).mean()
    assert np.abs(drifted.height.z_um - steady.height.z_um).mean() < 0.15 * moved_um
    assert drift_checks(drifted) == [pytest.approx(0.03, abs=2e-3)]
    assert drift_checks(steady) == [pytest.approx(0.0, abs=2e-3)]
    assert not drift_checks(without)


@pytest.mark.slow
def test_drift_of_presses_is_taken_out_and_noted(calibration: Calibration) -> None:
    assert calibration.skin_at_rest is not None
    assert calibration.skin_at_rest.gain_sigma == pytest.approx(0.015, rel=0.2)
    largest = np.abs(PRESSES - 1.0).max()
    (stated,) = (
        re.search(r"up to ([\d.]+)%", note) for note in calibration.assessment.notes if "lights differed" in note
    )
    assert stated is not None
    assert float(stated[1]) == pytest.approx(100.0 * largest, abs=0.2)


@pytest.mark.slow
def test_white_balance_is_taken_out_where_presses_show_it(calibration: Calibration) -> None:
    unsteady = calibrated(BALANCES)
    steady_um = scan(calibration, np.ones(3)).height.z_um
    balanced = scan(unsteady, BALANCE)
    assert drift_checks(balanced) == [pytest.approx(0.3, abs=0.01)]
    with pytest.raises(CalibrationMismatch, match=r"its lights differ from the calibration's by 30% \(at most 15%\)"):
        scan(calibration, BALANCE)
    assert np.abs(balanced.height.z_um - steady_um).mean() < 0.05 * steady_um.max()
