"""A library with good scans and a damaged one."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from device.acquisition.scanner import Scanner
from device.bundles.scan import Annotations
from device.store.store import BundleStore
from hal.board_profile import BoardProfile
from hal.clock import VirtualClock
from hal.interfaces import PressObject
from hal.simulator.bench import build
from hal.simulator.hardware import twin_hardware
from host_sync.calibration_file.calibrator import Calibrator
from host_sync.library.library import Library

OBJECTS = ("coin", "sphere", "coin")


@pytest.fixture(scope="module")
def library(
    calibrated_root: Path,
    small_twin: BoardProfile,
    tmp_path_factory: pytest.TempPathFactory,
    calibrator: Calibrator,
) -> Library:
    """Three scans of which the last has a damaged frame."""
    root = tmp_path_factory.mktemp("library") / "scans"
    shutil.copytree(calibrated_root, root)
    with twin_hardware(build(small_twin, VirtualClock())) as hardware:
        scanner = Scanner(hardware, BundleStore(root, hardware.clock, boot_id="b0075e22"))
        for shown in OBJECTS:
            hardware.operator.ask(PressObject(shown))
            hardware.button.wait_for_press(None)
            scanner.scan(Annotations())
    raw = Library(root).scans().bundles[-1].directory / "raw.tif"
    raw.chmod(0o600)
    raw.write_bytes(raw.read_bytes()[:-100])
    return Library(root)
