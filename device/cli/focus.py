"""`retroscan focus`: how sharp the camera sees, frame by frame, while a person turns the lens."""

from __future__ import annotations

from itertools import count
from typing import Final

from device.acquisition.capture import CaptureSettings, capture
from device.acquisition.instrument_lock import open_exclusive
from device.cli.console import Count, Given, print_line
from device.imaging.focus import focus_figure
from hal.board_profile import load_board_profile

BAR: Final = 40


def focus(*, frames: Count | None = None, options: Given) -> int:
    """Show how sharp the lens is set, until Ctrl-C.

    Parameters
    ----------
    frames
        End after that many frames.
    """
    print_line("Turn the focus ring through the largest figure and back to it. Ctrl-C ends.")
    best = 0.0
    with open_exclusive(load_board_profile(options.board)) as hardware:
        plan = CaptureSettings.of_board(hardware)
        for number in count(1):
            figure = focus_figure(capture(hardware, plan))
            best = max(best, figure)
            bar = "#" * round(BAR * figure / best) if best else ""
            print_line(f"{figure:8.2f}  best {best:8.2f}  {bar}")
            if number == frames:
                return 0
    return 0
