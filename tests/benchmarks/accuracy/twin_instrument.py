"""A calibrated twin: the reference profile with one skin, its full calibration, and new presses on it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import msgspec

from device.acquisition.calibrate import calibrate
from device.acquisition.capture import CaptureSettings, capture
from device.imaging.flat_field import demosaic
from device.store.store import BundleStore
from hal.board_profile import BoardProfile, load_board_profile
from hal.clock import VirtualClock
from hal.frame import RawFrame
from hal.interfaces import LiftOff, OperatorRequest, PressBall, PressObject
from hal.simulator.bench import TwinTruth, build
from hal.simulator.hardware import twin_hardware
from host_sync.calibration.calibrate import Calibration, Method
from host_sync.calibration_file.calibrator import calibration_of
from host_sync.reconstruction.pipeline import Reconstruction, reconstruct

BALL_RADIUS_MM: Final = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class TwinScan:
    """A new press: its raw frame and its truth."""

    name: str
    frame: RawFrame
    truth: TwinTruth


def reference_profile(skin: str, board: str = "twin") -> BoardProfile:
    """The reference profile (or the one with distant lights) with a skin of the named coat."""
    profile = load_board_profile(board)
    return msgspec.structs.replace(profile, twin=msgspec.structs.replace(profile.twin, skin=skin))


class TwinInstrument:
    """A twin with a typical calibration: twelve presses of one ball, found and fitted by the program.

    Parameters
    ----------
    profile : of the twin
    folder : where its store is made
    paper : whether its calibration holds the paper's model
    """

    def __init__(self, profile: BoardProfile, folder: Path, *, paper: bool = False) -> None:
        self.profile = profile
        self._bench = build(profile, VirtualClock(start_ns=5_000_000_000, wall_start_s=1_000.0))
        self.hardware = twin_hardware(self._bench)
        with self.hardware:
            store = BundleStore(folder, self.hardware.clock, boot_id="acc00000")
            outcome = calibrate(self.hardware, store, BALL_RADIUS_MM, lambda _: None)
        self.calibration: Calibration = calibration_of(outcome.bundle, paper=paper)

    def truth(self) -> TwinTruth:
        """What is pressed now, as it is."""
        return self._bench.truth()

    def lift_off(self) -> TwinScan:
        """A frame of untouched skin."""
        return self._scan("untouched skin", LiftOff())

    def press_ball(self, column_share: float, row_share: float) -> TwinScan:
        """Press the ball at a position in the field."""
        request = PressBall(BALL_RADIUS_MM, column_share, row_share)
        return self._scan(f"ball at ({column_share:g}, {row_share:g})", request)

    def press_object(self, name: str) -> TwinScan:
        """Press a specimen of the twin in the middle of the field."""
        return self._scan(name, PressObject(name))

    def reconstruct(self, scan: TwinScan, method: Method | None = None) -> Reconstruction:
        """The surface of a press, by the default method unless one is named."""
        return reconstruct(demosaic(scan.frame), self.calibration, scan.name, method)

    def _scan(self, name: str, request: OperatorRequest) -> TwinScan:
        hardware = self.hardware
        with hardware:
            hardware.operator.ask(request)
            hardware.button.wait_for_press(None)
            frame = capture(hardware, CaptureSettings.of_board(hardware))
        return TwinScan(name, frame, self._bench.truth())
