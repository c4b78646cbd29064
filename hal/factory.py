"""Opens the hardware that a board profile names."""

from __future__ import annotations

import time

from hal.board_profile import BoardProfile
from hal.clock import SystemClock, VirtualClock
from hal.hardware import Hardware
from hal.interfaces import Clock


def open_hardware(profile: BoardProfile, clock: Clock | None = None, seed: int | None = None) -> Hardware:
    """Return the hardware that the profile names, or an error; never a substitute.

    Parameters
    ----------
    clock : the clock to run on; the twin runs in virtual time by default
    seed : of the twin's noise and placement, instead of the profile's

    Raises
    ------
    BoardProfileError
        The profile lacks a table that its driver needs.
    """
    if profile.driver == "picamera2":
        from hal.drivers.board_hardware import board_hardware

        return board_hardware(profile, clock or SystemClock())
    if profile.driver == "uvc":
        from hal.drivers.usb_hardware import usb_hardware

        return usb_hardware(profile, clock or SystemClock())
    if profile.driver == "twin-camera":
        from hal.simulator.hardware import mirrored_board_hardware

        return mirrored_board_hardware(profile, clock or SystemClock(), seed)
    from hal.simulator.bench import build
    from hal.simulator.hardware import twin_hardware

    running = clock or VirtualClock(start_ns=time.monotonic_ns(), wall_start_s=time.time())
    return twin_hardware(build(profile, running, seed))
