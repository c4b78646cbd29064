"""`retroscan demo`: the screens on a simulated handheld whose faults can be switched, to learn the instrument by."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from device.acquisition.calibrate import calibrate
from device.cli.console import GivenSimulated, print_line
from device.cli.screens import require_terminal, show_screens
from device.command_line import Folder
from device.errors import NoCalibration
from device.instrument.calibration_run import BALL_RADIUS_MM
from device.instrument.demo_faults import DemoDisk, DemoFaults
from device.instrument.instrument import Instrument
from device.store.store import BundleStore, default_store
from hal.board_profile import load_board_profile
from hal.clock import SystemClock
from hal.errors import BoardProfileError
from hal.factory import open_hardware

BOARD: Final = "twin"
FOLDER: Final = "retroscan-demo"


def demo(*, store: Folder | None = None, simulated: GivenSimulated) -> int:
    """Show the screens on a simulated handheld; key f switches faults on and off.

    Returns the exit code.

    Its first start calibrates it, which takes about half a minute.

    Parameters
    ----------
    store
        Folder of its scans and calibrations; by default next to that of the real handheld, one for each board.
    """
    profile = load_board_profile(simulated.board)
    if profile.driver != "twin":
        raise BoardProfileError(f"{simulated.board}: is no simulated handheld: name twin or twin-distant, or no board")
    require_terminal()
    folder = store or simulated.store_folder or default_store().with_name(folder_name(simulated.board))
    prepare(folder, simulated.board)
    hardware, disk = open_hardware(profile, SystemClock()), DemoDisk(folder)
    instrument = Instrument(hardware, BundleStore(folder, hardware.clock, statvfs=disk))
    return show_screens(instrument, hardware, folder, DemoFaults(instrument, disk))


def folder_name(board: str) -> str:
    """Name of a board's folder: a calibration of one simulated handheld does not serve another."""
    return FOLDER if board == BOARD else f"{FOLDER}-{Path(board).stem}"


def prepare(folder: Path, board: str = BOARD) -> None:
    """Calibrate the twin into a store unless that has a calibration; virtual time makes it faster than a person."""
    with open_hardware(load_board_profile(board)) as hardware:
        made = BundleStore(folder, hardware.clock)
        try:
            made.active_calibration()
        except NoCalibration:
            print_line(
                "Preparing the demonstration: the simulated operator calibrates, about half a minute, only once."
            )
            calibrate(hardware, made, BALL_RADIUS_MM, lambda _: None)
