"""`retroscan guide` on the twin: the way back to an earlier touch, and no direction where there is none to know."""

from __future__ import annotations

import json
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from device.acquisition.capture import capture
from device.acquisition.scanner import Scanner
from device.cli.guide import NOT_REACHED
from device.cli.main import main
from device.guidance.placement import Placement, Target, Unplaced, placed
from device.imaging.flat_field import bin_bayer
from device.quick_look.solver import quick_look
from device.store.store import BundleStore
from hal.board_profile import BoardProfile
from hal.clock import VirtualClock
from hal.simulator.bench import build
from hal.simulator.hardware import twin_hardware
from hal.simulator.scene import Press


@dataclass(frozen=True)
class Bumps:
    """Two hundred bumps at random places of an endless plane."""

    seed: int

    def height_mm(self, x_mm: NDArray[np.float64], y_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        random = np.random.default_rng(self.seed)
        height = np.full(np.shape(x_mm), -0.15)
        for x, y, high, wide in random.uniform((-16, -14, 0.04, 0.4), (16, 14, 0.15, 1.0), (200, 4)):
            height = np.maximum(height, -0.15 + high * np.exp(-((x_mm - x) ** 2 + (y_mm - y) ** 2) / wide**2))
        return height


@pytest.fixture
def retroscan(calibrated_root: Path, tmp_path: Path, small_board: Path) -> list[str]:
    shutil.copytree(calibrated_root, tmp_path / "store")
    return ["--board", str(small_board), "--store", str(tmp_path / "store")]


def test_a_touch_away_from_the_spot_says_the_way_back(
    calibrated_root: Path, tmp_path: Path, small_twin: BoardProfile
) -> None:
    """The object lies 3 mm further right and 2 mm further up than it did, so the instrument follows it."""
    shutil.copytree(calibrated_root, tmp_path / "store")
    bench = build(small_twin, VirtualClock(start_ns=5_000_000_000, wall_start_s=1_000.0))
    with twin_hardware(bench) as hardware:
        scanner = Scanner(hardware, BundleStore(tmp_path / "store", hardware.clock))
        bench.place(Press(Bumps(1), (0.0, 0.0), 0.0, 0.5))
        earlier = quick_look(bin_bayer(capture(hardware, scanner.plan), scanner.model.binning), scanner.model)
        target = Target(earlier.height)
        bench.place(Press(Bumps(1), (3.0, -2.0), float(np.radians(4.0)), 0.4))
        found = placed(capture(hardware, scanner.plan), scanner.model, target)
        assert isinstance(found, Placement)
        assert (found.right_mm, found.down_mm) == pytest.approx((3.0, -2.0), abs=0.2)
        assert found.clockwise_deg == pytest.approx(4.0, abs=1.0)
        bench.place(Press(Bumps(2), (0.0, 0.0), 0.0, 0.5))
        assert isinstance(placed(capture(hardware, scanner.plan), scanner.model, target), Unplaced)


def test_the_command_gives_no_direction_that_it_does_not_know(
    retroscan: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    """The twin's coin repeats itself around its middle, and a step is another object."""
    assert main([*retroscan, "scan", "--object", "coin", "--json"]) == 0
    scan = json.loads(capsys.readouterr().out)["scan"]
    arguments = [*retroscan, "guide", "--to", scan, "--touches", "1"]
    assert main([*arguments, "--json"]) == NOT_REACHED
    said = json.loads(capsys.readouterr().out)
    assert (said["to"], said["placement"], said["on_the_spot"]) == (scan, None, False)
    assert "alike" in said["sentence"]
    assert main([*arguments, "--object", "step"]) == NOT_REACHED
    assert "Place unknown" in capsys.readouterr().out


def test_a_scan_that_does_not_exist_is_refused(retroscan: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*retroscan, "guide", "--to", "rg60bb5d63-000999-scan"]) == 2
    assert "rg60bb5d63-000999-scan" in capsys.readouterr().err
