"""A press that deepens in steps, for movies."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from device.acquisition.precise_capture import MOVIE_S
from hal.hardware import Hardware
from hal.interfaces import PressObject
from hal.simulator.bench import SimulatedScene

STEPS: Final = 4


def press_deeper(
    bench: SimulatedScene, hardware: Hardware, name: str = "coin", within_s: float = 0.5 * MOVIE_S
) -> None:
    """Press an object in steps, by default over the first half of a movie that begins now."""
    hardware.operator.ask(PressObject(name))
    hardware.button.wait_for_press(None)
    whole = bench.pressed
    assert whole is not None
    bench.place(None)
    began_ns = bench.clock.monotonic_ns()
    for step in range(1, STEPS + 1):
        at_ns = began_ns + round(within_s * 1e9 * step / STEPS)
        bench.place_at(at_ns, replace(whole, indentation_mm=whole.indentation_mm * step / STEPS))
