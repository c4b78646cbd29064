"""Press guide and verdict agree: what is ready makes a good scan, and what the guide finds at fault does not."""

import pytest

from device.instrument.events import ScanFinished
from device.instrument.instrument import Instrument
from device.store.store import BundleStore
from hal.hardware import Hardware
from hal.interfaces import ButtonPress
from hal.simulator.bench import SimulatedScene
from hal.simulator.operator import specimen
from hal.simulator.scene import Press
from hal.simulator.surfaces import Block, Plane, Sphere, Surface

COIN, COIN_MM = specimen("coin").surface, specimen("coin").indentation_mm

PRESSES: list[tuple[Surface | None, float, dict[str, float], str, str]] = [
    (Sphere(3.0), 0.9, {}, "ready", "relief over"),
    (COIN, COIN_MM, {}, "ready", "relief over"),
    (None, 0.0, {}, "press", "hardly any contact"),
    (Sphere(3.0), 0.1, {}, "press more", "too little pressure"),
    (Sphere(3.0), 1.45, {}, "too deep", "too deep"),
    (Plane(Block(3.0, 3.0), 0.14, 0.0), 0.8, {}, "press flatter", "tilted by"),
    (Sphere(3.0), 1.45, {"green": 0.0}, "lights", "light green is at"),
    (COIN, COIN_MM, {"blue": 0.6}, "lights", "light blue is at"),
    (None, 0.0, {"red": 0.3}, "lights", "light red is"),
]


def test_guide_and_verdict_say_the_same(bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore) -> None:
    with Instrument(hardware, calibrated) as instrument:
        for surface, depth_mm, dimmed, advice, words in PRESSES:
            bench.faults.dimmed = {}
            bench.place(None)
            for _ in range(30):
                instrument.step()
            bench.faults.dimmed = dimmed
            bench.place(surface and Press(surface, (0.0, 0.0), 0.0, depth_mm))
            for _ in range(12):
                instrument.step()
            live = instrument.state.live
            assert live is not None
            bench.schedule_button(ButtonPress(bench.clock.monotonic_ns() + 10_000_000, 0.05))
            for _ in range(4):
                instrument.step()
            bench.place(None)
            for _ in range(40):
                instrument.step()
            (finished,) = [event for event in instrument.take_events() if isinstance(event, ScanFinished)]
            assert (live.reading.advice, finished.verdict.level == "good") == (advice, advice == "ready"), finished
            assert words in finished.verdict.reason
            if advice == "ready":
                figures = finished.verdict.figures
                assert figures["contact_share"] == pytest.approx(live.reading.contact_fraction, abs=0.02)
                assert figures["tilt_deg"] == pytest.approx(live.reading.tilt_deg, abs=0.5)
