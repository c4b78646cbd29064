"""`retroscan focus`: how sharp the camera sees, frame by frame, while a person turns the lens."""

from __future__ import annotations

from itertools import count
from typing import Final

from device.acquisition.capture import CaptureSettings, capture
from device.acquisition.instrument_lock import open_exclusive
from device.cli.console import Count, Given, print_line
from device.imaging.focus import FocusMeter
from hal.board_profile import load_board_profile

BAR: Final = 40


def focus(*, frames: Count | None = None, options: Given) -> int:
    """Show how sharp the lens is set, until Ctrl-C.

    Parameters
    ----------
    frames
        End after that many frames.
    """
    print_line("Lay a coin or print on the gel and turn the lens's focus ring. Ctrl-C ends.")
    meter = FocusMeter()
    with open_exclusive(load_board_profile(options.board)) as hardware:
        plan = CaptureSettings.of_board(hardware)
        for number in count(1):
            reading = meter.read(capture(hardware, plan))
            bar = "#" * round(BAR * reading.fraction)
            print_line(f"{reading.figure:8.2f}  best {reading.best:8.2f}  {bar:<{BAR}}  {reading.advice}")
            if number == frames:
                return 0
    return 0
