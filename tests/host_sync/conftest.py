"""Calibrations of the workstation, made once for a state of the sources: files in a cache that all tests share."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from filelock import FileLock
from limits import WAIT_S

from device.bundles.calibration import CalibrationBundle
from device.store.store import BundleStore
from hal.clock import VirtualClock
from host_sync.calibration_file.calibrator import Calibrator
from host_sync.calibration_file.inputs import CalibrationCache
from host_sync.cli import console
from host_sync.kernels.cache import USER_CACHE, configure_cache


@pytest.fixture(scope="session", autouse=True)
def calibration_cache(
    pytestconfig: pytest.Config, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[CalibrationCache]:
    """The cache of the commands in tests, which later runs share; compiled kernels stay in the user's."""
    kept = getattr(pytestconfig, "cache", None)  # some tests run pytest without one
    folder = tmp_path_factory.mktemp("cache") if kept is None else kept.mkdir("retrograph")
    configure_cache()
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(USER_CACHE, str(folder))
        patch.setattr(console, "LINES_EVERY_S", 1e6)  # no command writes its steps as time passes
        yield CalibrationCache.of_user()


@pytest.fixture(scope="session")
def twin_bundle(calibrated_root: Path) -> CalibrationBundle:
    """The active calibration of the small twin."""
    return BundleStore(calibrated_root, VirtualClock(), boot_id="b0075e1f").active_calibration()


@pytest.fixture(scope="session")
def calibrator(calibration_cache: CalibrationCache, twin_bundle: CalibrationBundle, shared_folder: Path) -> Calibrator:
    """A calibrator that has made the calibration of the small twin."""
    found = Calibrator(calibration_cache)
    with FileLock(shared_folder / "calibration of the twin.lock", timeout=WAIT_S):
        found.of_bundle(twin_bundle)
    return found
