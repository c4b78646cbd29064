"""`retroscan` on a wired board in real time, told on standard output what its LEDs do; a test sends it signals.

Its camera delivers nothing, so that it stays lit while it waits for a frame.
"""

import sys

from device import __main__ as program
from hal.board_profile import BoardProfile
from hal.clock import SystemClock
from hal.hardware import Hardware
from hal.interfaces import ButtonPress
from hal.twin.bench import build
from hal.twin.wired.hardware import wired_hardware


def open_lit_hardware(profile: BoardProfile) -> Hardware:
    """A board whose button is pushed at once, and whose chip model tells of every change of its outputs."""
    wired = wired_hardware(build(profile, SystemClock()), "PCA9955B")
    follow, told = wired.leds.changed, []

    def tell() -> None:
        follow()
        state = "lit" if any(wired.leds.currents_ma()[:15]) else "dark"
        if told[-1:] != [state]:
            told.append(state)
            sys.stdout.write(f"{state}\n")
            sys.stdout.flush()

    wired.leds.changed = tell
    wired.bench.faults.camera_stalled = True
    now_ns = wired.bench.clock.monotonic_ns()
    wired.bench.schedule_button(ButtonPress(now_ns + 50_000_000, 0.05))
    return wired.hardware


program.open_hardware = open_lit_hardware
sys.exit(program.main())
