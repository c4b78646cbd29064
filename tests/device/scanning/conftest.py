"""A whole twin of a small field: its instrument, its store, and the truth of what is pressed."""

import shutil
from pathlib import Path

import pytest

from device.bundle_store import BundleStore
from hal.board_profile import BoardProfile
from hal.clock import VirtualClock
from hal.hardware import Hardware
from hal.twin.bench import Bench, build
from hal.twin.hardware import twin_hardware


@pytest.fixture
def bench(small_twin: BoardProfile) -> Bench:
    return build(small_twin, VirtualClock(start_ns=5_000_000_000, wall_start_s=1_000.0))


@pytest.fixture
def hardware(bench: Bench) -> Hardware:
    return twin_hardware(bench)


@pytest.fixture
def store(tmp_path: Path, hardware: Hardware) -> BundleStore:
    return BundleStore(tmp_path / "store", hardware.clock, boot_id="b0075e1f")


@pytest.fixture
def calibrated(calibrated_root: Path, tmp_path: Path, hardware: Hardware) -> BundleStore:
    root = tmp_path / "calibrated"
    shutil.copytree(calibrated_root, root)
    return BundleStore(root, hardware.clock, boot_id="b0075e1f")
