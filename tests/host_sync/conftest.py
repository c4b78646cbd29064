"""Calibrations of the workstation, made once in a session however many commands begin with one."""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Callable, Iterator

import pytest

from host_sync.calibration.calibrate import Calibration
from host_sync.calibration.frames import CalibrationFrames, calibrate_frames
from host_sync.calibration_file import calibrator, kept_calibration
from host_sync.calibration_report.report import report_files
from host_sync.evaluation import figures, held_out_ball
from host_sync.kernels.cache import USER_CACHE


class Calibrated:
    """What was calibrated so far, by the frames, and the reports of it."""

    def __init__(self) -> None:
        self._made: dict[str, Calibration] = {}
        self._reports: dict[tuple[str, bool], dict[str, bytes]] = {}

    def calibrate(self, frames: CalibrationFrames, tell: Callable[[str], None] = lambda _: None) -> Calibration:
        """The calibration of these very frames: computed the first time."""
        key = hashlib.sha256(pickle.dumps(frames)).hexdigest()
        if key not in self._made:
            self._made[key] = calibrate_frames(frames, tell)
        return self._made[key]

    def report(self, calibration: Calibration) -> dict[str, bytes]:
        """The report's files: drawn the first time."""
        key = calibration.calibration_id, calibration.paper is not None
        if key not in self._reports:
            self._reports[key] = report_files(calibration)
        return self._reports[key]


@pytest.fixture(scope="session", autouse=True)
def no_cache_of_the_user() -> Iterator[None]:
    """No command finds a calibration of an earlier run, or leaves one."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(USER_CACHE, "")
        yield


@pytest.fixture(scope="session")
def calibrated_so_far() -> Calibrated:
    return Calibrated()


@pytest.fixture(scope="module")
def calibrated_once(calibrated_so_far: Calibrated) -> Iterator[None]:
    """No command of this module calibrates from frames that were calibrated from before: it would get the same."""
    with pytest.MonkeyPatch.context() as patch:
        for caller in (calibrator, kept_calibration, figures, held_out_ball):
            patch.setattr(caller, "calibrate_frames", calibrated_so_far.calibrate)
        patch.setattr(kept_calibration, "report_files", calibrated_so_far.report)
        yield
