"""Killed at any moment: after a restart every published scan is there and complete."""

import os
import shutil
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from limits import running

from device.store.store import BundleStore
from hal.clock import VirtualClock

PROGRAM = Path(__file__).with_name("scanning_program.py")
REPOSITORY = Path(__file__).parents[3]


def killed_after(root: Path, scans: int, more_s: float) -> list[str]:
    """Ids that the program reported before it was killed, `more_s` after it reported that many scans."""
    environment = os.environ | {"PYTHONPATH": str(REPOSITORY)}
    with running([sys.executable, PROGRAM, root], stdout=subprocess.PIPE, text=True, env=environment) as ran:
        assert ran.stdout is not None
        reported = [ran.stdout.readline().strip() for _ in range(scans)]
        with suppress(subprocess.TimeoutExpired):
            ran.wait(more_s)  # the kill falls anywhere in the next scan
        ran.send_signal(signal.SIGKILL)
        reported += ran.stdout.read().split()
    assert ran.returncode == -signal.SIGKILL
    return reported


def check_restart(root: Path, reported: list[str]) -> None:
    """The store after a restart: nothing damaged, nothing partial, everything that was reported."""
    store = BundleStore(root, VirtualClock())
    listing = store.scans()
    assert listing.damaged == ()
    assert set(reported) <= {bundle.scan_id for bundle in listing.bundles}
    for bundle in listing.bundles:
        bundle.verify()
    assert [path.name for path in (root / "scans").iterdir() if path.name.startswith(".")] == []
    counters = [bundle.record.identity.counter for bundle in listing.bundles]
    assert len(set(counters)) == len(counters)


def kill_often(calibrated_root: Path, tmp_path: Path, times: int) -> None:
    root = tmp_path / "store"
    shutil.copytree(calibrated_root, root)
    chance = np.random.default_rng(7)
    reported: list[str] = []
    for _ in range(times):
        reported += killed_after(root, int(chance.integers(1, 4)), float(chance.uniform(0.0, 0.08)))
        check_restart(root, reported)
    assert len(reported) >= times


def test_killed_in_the_middle_nothing_is_lost_or_half(calibrated_root: Path, tmp_path: Path) -> None:
    kill_often(calibrated_root, tmp_path, 2)


@pytest.mark.slow
def test_killed_a_hundred_times_nothing_is_lost_or_half(calibrated_root: Path, tmp_path: Path) -> None:
    kill_often(calibrated_root, tmp_path, 100)
