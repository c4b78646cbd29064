"""The calibration of the small twin, and one of its presses."""

from pathlib import Path

import pytest

from device.bundles.calibration import CalibrationBundle
from device.store.registry_file import read_active
from hal.frame import RawFrame


@pytest.fixture(scope="session")
def calibration(calibrated_root: Path) -> CalibrationBundle:
    return read_active(calibrated_root)


@pytest.fixture(scope="session")
def press(calibration: CalibrationBundle) -> RawFrame:
    return calibration.press_frame(calibration.record.presses[5])
