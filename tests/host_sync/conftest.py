"""Calibrations of the workstation, made once in a session however many commands begin with one."""

from __future__ import annotations

import hashlib
import pickle
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from device.io.atomic import atomic_directory
from host_sync.calibration.calibrate import Calibration
from host_sync.calibration.frames import CalibrationFrames, calibrate_frames
from host_sync.calibration_report.report import REPORT_FILE, write_report
from host_sync.evaluation import figures, held_out_ball
from host_sync.reconstruction import from_frame_set, from_library


class Calibrated:
    """What was calibrated so far, by the frames, and the reports of it."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._made: dict[str, Calibration] = {}

    def calibrate(self, frames: CalibrationFrames, tell: Callable[[str], None] = lambda _: None) -> Calibration:
        """The calibration of these very frames: computed the first time."""
        key = hashlib.sha256(pickle.dumps(frames)).hexdigest()
        if key not in self._made:
            self._made[key] = calibrate_frames(frames, tell)
        return self._made[key]

    def report(self, target: Path, calibration: Calibration) -> None:
        """The report in its place: drawn the first time."""
        drawn = self._folder / calibration.calibration_id
        if drawn.is_dir():
            with atomic_directory(target, REPORT_FILE) as folder:
                shutil.copytree(drawn, folder, dirs_exist_ok=True)
            return
        write_report(target, calibration)
        shutil.copytree(target, drawn)


@pytest.fixture(scope="session")
def calibrated_so_far(tmp_path_factory: pytest.TempPathFactory) -> Calibrated:
    return Calibrated(tmp_path_factory.mktemp("reports"))


@pytest.fixture(scope="module")
def calibrated_once(calibrated_so_far: Calibrated) -> Iterator[None]:
    """No command of this module calibrates from frames that were calibrated from before: it would get the same."""
    with pytest.MonkeyPatch.context() as patch:
        for caller in (from_frame_set, from_library, figures, held_out_ball):
            patch.setattr(caller, "calibrate_frames", calibrated_so_far.calibrate)
        for caller in (from_frame_set, from_library):
            patch.setattr(caller, "write_report", calibrated_so_far.report)
        yield
