"""The store of the small twin's instrument."""

from pathlib import Path

import pytest

from device.store.store import BundleStore
from hal.hardware import Hardware


@pytest.fixture
def store(tmp_path: Path, hardware: Hardware) -> BundleStore:
    return BundleStore(tmp_path / "store", hardware.clock, boot_id="b0075e1f")
