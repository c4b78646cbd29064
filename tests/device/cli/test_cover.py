"""`retroscan cover` on the twin: presses where the hand is sent cover an area; an unknown place covers nothing."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from device.acquisition.capture import capture
from device.acquisition.scanner import Scanner
from device.cli.guide import NOT_COVERED
from device.cli.main import main
from device.guidance.cover_task import CoverTask, InstrumentPose
from device.imaging.flat_field import bin_bayer
from device.quick_look.solver import quick_look
from device.store.store import BundleStore
from device.surface import HeightMap
from hal.board_profile import BoardProfile
from hal.clock import VirtualClock
from hal.simulator.bench import build
from hal.simulator.hardware import twin_hardware
from hal.simulator.scene import Press
from tests.device.cli.test_guide import Bumps


@pytest.fixture
def retroscan(calibrated_root: Path, tmp_path: Path, small_board: Path) -> list[str]:
    shutil.copytree(calibrated_root, tmp_path / "store")
    return ["--board", str(small_board), "--store", str(tmp_path / "store")]


def test_an_area_is_covered_on_the_twin(calibrated_root: Path, tmp_path: Path, small_twin: BoardProfile) -> None:
    """The object moves the other way than the instrument."""
    shutil.copytree(calibrated_root, tmp_path / "store")
    bench = build(small_twin, VirtualClock(start_ns=5_000_000_000, wall_start_s=1_000.0))
    random = np.random.default_rng(5)
    with twin_hardware(bench) as hardware:
        scanner = Scanner(hardware, BundleStore(tmp_path / "store", hardware.clock))

        def touched(at_mm: tuple[float, float]) -> HeightMap:
            bench.place(Press(Bumps(1), (-at_mm[0], -at_mm[1]), 0.0, 0.5))
            return quick_look(bin_bayer(capture(hardware, scanner.plan), scanner.model.binning), scanner.model).height

        start = np.array([-4.0, -3.0])
        first = touched((float(start[0]), float(start[1])))
        field_mm = [size * first.pitch_um * 1e-3 for size in first.z_um.shape[::-1]]
        task = CoverTask(1.4 * field_mm[0], 1.4 * field_mm[1])
        task.add(first)
        at = start
        for _ in range(8):
            if task.way is None:
                break
            at = at + np.array(task.way) + random.normal(0.0, 0.3, 2)
            task.add(touched((float(at[0]), float(at[1]))))
            pose = task.pose
            assert isinstance(pose, InstrumentPose)
            assert (pose.right_mm, pose.down_mm) == pytest.approx(tuple(at - start), abs=0.5)
            assert pose.overlap > 0.25
        assert task.share > 0.97
        assert task.is_done
        assert set("".join(task.map().lines(60))) <= set("#·o")


def test_presses_that_look_alike_cover_nothing_more(retroscan: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    """The twin's coin repeats itself around its middle."""
    area = ["--width-mm", "60", "--height-mm", "40"]
    assert main([*retroscan, "cover", *area, "--presses", "2", "--json"]) == NOT_COVERED
    first, second = (json.loads(line) for line in capsys.readouterr().out.splitlines())
    assert (first["stand"]["overlap"], second["stand"]) == (1.0, None)
    assert first["covered"] == second["covered"] > 0.0
    assert "Place unknown" in second["sentence"]
    assert first["scan"] != second["scan"]


def test_an_area_of_one_field_is_covered_by_one_press(retroscan: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*retroscan, "cover", "--width-mm", "1", "--height-mm", "1"]) == 0
    said = capsys.readouterr().out
    assert "Covered: 100%" in said


def test_an_area_without_size_is_refused(retroscan: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*retroscan, "cover", "--width-mm", "0", "--height-mm", "10"]) == 2
    assert "--width-mm" in capsys.readouterr().err
