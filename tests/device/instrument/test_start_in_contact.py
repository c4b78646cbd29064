"""Switched on with an object in contact: no scan is good before untouched skin was seen, which is then measured."""

import pytest

from device.bundles.scan import VerdictRecord
from device.instrument.events import ScanFinished
from device.instrument.instrument import Instrument
from device.quality.verdict import LIGHTS_UNKNOWN
from device.store.store import BundleStore
from hal.hardware import Hardware
from hal.interfaces import ButtonPress
from hal.simulator.bench import SimulatedScene
from hal.simulator.operator import specimen
from hal.simulator.scene import Press
from hal.simulator.surfaces import Block, Sphere, Surface
from tests.apparatus.random_presses import WHOLE_FIELD_OBJECTS

CONTACT_STEPS = 40
"""Live frames under the object before the push and again after it: two seconds, in which attempts to measure the
lights fail."""

MAX_VERDICT_S = 2.0


def started_under(
    name: str, bench: SimulatedScene, hardware: Hardware, store: BundleStore, *, lifts: bool
) -> tuple[VerdictRecord, float]:
    """Verdict of a push, and the time from the lift to it, s, of an instrument that is switched on under an object."""
    if name in WHOLE_FIELD_OBJECTS:
        surface, depth_mm = WHOLE_FIELD_OBJECTS[name]
    else:
        surface, depth_mm = specimen(name).surface, specimen(name).indentation_mm
    bench.place(Press(surface, (0.0, 0.0), 0.0, depth_mm))
    with Instrument(hardware, store) as instrument:
        for _ in range(CONTACT_STEPS):
            instrument.step()
        bench.schedule_button(ButtonPress(bench.clock.monotonic_ns() + 50_000_000, 0.05))
        for _ in range(CONTACT_STEPS):
            instrument.step()
        if lifts:
            bench.place(None)
        lifted_ns = bench.clock.monotonic_ns()
        for _ in range(600):
            instrument.step()
            for event in instrument.take_events():
                if isinstance(event, ScanFinished):
                    return event.verdict, (event.at_ns - lifted_ns) * 1e-9
    raise AssertionError("no scan came of the push")


@pytest.mark.parametrize("name", ["coin", "step", "whole-weave", "whole-plane"])
def test_its_lights_are_measured_at_once_after_the_lift(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore, name: str
) -> None:
    verdict, waited_s = started_under(name, bench, hardware, calibrated, lifts=True)
    assert verdict.level == "good", verdict.reason
    assert waited_s < MAX_VERDICT_S


@pytest.mark.parametrize("name", ["coin", "whole-weave", "whole-plane"])
def test_without_a_lift_it_is_never_good(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore, name: str
) -> None:
    verdict, _ = started_under(name, bench, hardware, calibrated, lifts=False)
    assert (verdict.level, verdict.reason) == ("doubtful", LIGHTS_UNKNOWN)


@pytest.mark.parametrize("level", [0.9, 0.975, 1.1])
def test_a_light_that_was_off_from_the_start_is_named(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore, level: float
) -> None:
    bench.faults.dimmed = {"green": level}
    verdict, _ = started_under("coin", bench, hardware, calibrated, lifts=True)
    assert verdict.level == "doubtful"
    assert "light green is" in verdict.reason


@pytest.mark.parametrize(
    ("surface", "depth_mm"), [(Sphere(0.5), 0.1), (Sphere(3.0), 0.05), (Block(0.2, 0.2), 0.05), (Block(1.0, 1.0), 0.3)]
)
@pytest.mark.parametrize("centre_mm", [(0.0, 0.0), (-4.5, 3.0)])
def test_a_small_object_is_not_taken_for_dust(
    bench: SimulatedScene,
    hardware: Hardware,
    calibrated: BundleStore,
    surface: Surface,
    depth_mm: float,
    centre_mm: tuple[float, float],
) -> None:
    bench.place(Press(surface, centre_mm, 0.0, depth_mm))
    with Instrument(hardware, calibrated) as instrument:
        for _ in range(CONTACT_STEPS):
            instrument.step()
        assert set(instrument.state.health.light_change.values()) == {None}
        bench.place(None)
        changes: list[float | None] = [None]
        for _ in range(1000):
            instrument.step()
            changes = list(instrument.state.health.light_change.values())
            if None not in changes:
                break
        assert all(change is not None and abs(change) < 0.01 for change in changes), changes


def test_dust_does_not_hinder_the_measurement_of_the_lights(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore
) -> None:
    bench.faults.dirty = True
    with Instrument(hardware, calibrated) as instrument:
        for _ in range(2 * CONTACT_STEPS):
            instrument.step()
        assert None not in instrument.state.health.light_change.values()
