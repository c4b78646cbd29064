"""A whole twin of a small field: its instrument, its store, and the truth of what is pressed."""

import shutil
from pathlib import Path

import msgspec
import pytest

from device.bundle_store import BundleStore
from device.scanning.calibrate import calibrate
from hal.board_profile import BoardProfile, load_board_profile
from hal.clock import VirtualClock
from hal.hardware import Hardware
from hal.twin.bench import Bench, build
from hal.twin.hardware import twin_hardware


def small(name: str) -> BoardProfile:
    """A board of the twin with a quarter of its resolution over the same field."""
    reference = load_board_profile(name)
    sensor = msgspec.structs.replace(reference.sensor, columns=364, rows=272, pixel_pitch_um=48.0)
    return msgspec.structs.replace(reference, sensor=sensor)


@pytest.fixture
def bench() -> Bench:
    return build(small("twin"), VirtualClock(start_ns=5_000_000_000, wall_start_s=1_000.0))


@pytest.fixture
def hardware(bench: Bench) -> Hardware:
    return twin_hardware(bench)


@pytest.fixture
def store(tmp_path: Path, hardware: Hardware) -> BundleStore:
    return BundleStore(tmp_path / "store", hardware.clock, boot_id="b0075e1f")


@pytest.fixture(scope="session")
def calibrated_root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store with an active calibration, made once; tests work on copies of it."""
    root = tmp_path_factory.mktemp("calibrated") / "store"
    hardware = twin_hardware(build(small("twin"), VirtualClock(start_ns=5_000_000_000, wall_start_s=1_000.0)))
    with hardware:
        calibrate(hardware, BundleStore(root, hardware.clock, boot_id="b0075e1f"), 3.0, lambda _: None)
    return root


@pytest.fixture
def calibrated(calibrated_root: Path, tmp_path: Path, hardware: Hardware) -> BundleStore:
    root = tmp_path / "calibrated"
    shutil.copytree(calibrated_root, root)
    return BundleStore(root, hardware.clock, boot_id="b0075e1f")
