"""`retroscan` on an emulated board in real time that prints what its LEDs do; a test sends it signals.

Its camera delivers nothing, so that it stays lit while it waits for a frame. With SLOW_BUS set, each transfer while it
is lit is printed and takes 0.2 s.
"""

import os
import sys
import time

from emulated_board import emulated_hardware

from device.acquisition import instrument_lock
from device.cli import main as program
from hal.board_profile import BoardProfile
from hal.clock import SystemClock
from hal.hardware import Hardware
from hal.interfaces import ButtonPress
from hal.simulator.bench import build
from hal.simulator.led_chips import RegisterChip


def open_lit_hardware(profile: BoardProfile, _clock: object = None, seed: int = 0) -> Hardware:
    """A board whose button is pushed at once, and whose chip model reports every change of its outputs."""
    emulated = emulated_hardware(build(profile, SystemClock()), "PCA9955B")
    follow, reach, printed = emulated.leds.changed, emulated.wire.reach, []

    def say(word: str) -> None:
        printed.append(word)
        sys.stdout.write(f"{word}\n")
        sys.stdout.flush()

    def report_change() -> None:
        follow()
        state = "lit" if any(emulated.leds.currents_ma()[:15]) else "dark"
        if [word for word in printed if word != "transfer"][-1:] != [state]:
            say(state)

    def reach_slowly(address: int) -> RegisterChip:
        if "lit" in printed and "SLOW_BUS" in os.environ:
            say("transfer")
            time.sleep(0.2)
        return reach(address)

    emulated.leds.changed = report_change
    emulated.wire.reach = reach_slowly
    emulated.bench.faults.camera_stalled = True
    now_ns = emulated.bench.clock.monotonic_ns()
    emulated.bench.schedule_button(ButtonPress(now_ns + 50_000_000, 0.05))
    return emulated.hardware


instrument_lock.open_hardware = open_lit_hardware
sys.exit(program.main())
