"""Drift is reported before it costs accuracy, and only where there is some."""

import pytest

from device.instrument.events import ScanFinished
from device.instrument.instrument import Instrument
from device.quality.verdict import LIGHTS_UNKNOWN
from device.store.store import BundleStore
from hal.hardware import Hardware
from hal.interfaces import ButtonPress
from hal.simulator.bench import SimulatedScene
from hal.simulator.operator import specimen
from hal.simulator.scene import Press
from hal.simulator.surfaces import Block, Plane, Sphere, Surface, Texture

WHOLE_FIELD = Block(20.0, 20.0)


def press_and_scan(instrument: Instrument, bench: SimulatedScene, surface: Surface, depth_mm: float) -> ScanFinished:
    """Lift, press, push the button, lift, and the scan that comes of it."""
    bench.place(None)
    for _ in range(12):
        instrument.step()
    bench.place(Press(surface, (0.0, 0.0), 0.0, depth_mm))
    bench.schedule_button(ButtonPress(bench.clock.monotonic_ns() + 150_000_000, 0.05))
    for _ in range(8):
        instrument.step()
    bench.place(None)
    for _ in range(60):
        instrument.step()
        for event in instrument.take_events():
            if isinstance(event, ScanFinished):
                return event
    raise AssertionError("no scan came of the push")


@pytest.mark.parametrize("light", ["red", "blue"])
def test_a_light_that_loses_a_percent_a_scan_is_named_within_five_scans(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore, light: str
) -> None:
    levels = []
    with Instrument(hardware, calibrated) as instrument:
        for scan in range(1, 6):
            bench.faults.dimmed[light] = 0.99**scan
            verdict = press_and_scan(instrument, bench, Texture(WHOLE_FIELD, 0.012, 0.5, 0.15), 0.4).verdict
            levels.append(verdict.level)
    assert "doubtful" in levels
    assert f"light {light} is" in verdict.reason
    assert "weaker than at calibration" in verdict.reason
    assert verdict.figures[f"light_change_{light}"] == pytest.approx(0.99**5 - 1.0, abs=0.003)


def contacts() -> list[tuple[Surface, float]]:
    """Everything that is pressed in a day: small things, and things that cover the whole field."""
    small = [
        (specimen(name).surface, specimen(name).indentation_mm) for name in ("coin", "plane", "sphere-grid", "step")
    ]
    return [
        *small,
        (Sphere(3.0), 0.9),
        (Texture(WHOLE_FIELD, 0.012, 0.5, 0.15), 0.4),
        (Plane(WHOLE_FIELD, 0.012, 0.005), 0.9),
        (Texture(WHOLE_FIELD, 0.02, 1.1, 0.3), 0.6),
    ]


def ambers(scans: int, bench: SimulatedScene, hardware: Hardware, store: BundleStore) -> list[str]:
    """Reasons of every verdict that was not good."""
    found = []
    things = contacts()
    with Instrument(hardware, store) as instrument:
        for scan in range(scans):
            verdict = press_and_scan(instrument, bench, *things[scan % len(things)]).verdict
            if verdict.level != "good":
                found.append(f"{scan}: {verdict.reason}")
    return found


def test_no_scan_is_doubted_while_nothing_drifts(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore
) -> None:
    assert ambers(len(contacts()), bench, hardware, calibrated) == []


@pytest.mark.slow
def test_two_hundred_scans_without_drift_are_all_good(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore
) -> None:
    assert ambers(200, bench, hardware, calibrated) == []


@pytest.mark.slow
def test_whole_contact_without_lifting_is_not_taken_for_drift_and_never_good(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore
) -> None:
    """No untouched skin for the whole run: the light levels must be unknown, and unknown lights make no good scan."""
    with Instrument(hardware, calibrated) as instrument:
        bench.place(Press(Texture(WHOLE_FIELD, 0.012, 0.5, 0.15), (0.0, 0.0), 0.0, 0.4))
        for _ in range(30):
            bench.schedule_button(ButtonPress(bench.clock.monotonic_ns() + 100_000_000, 0.05))
            for _ in range(10):
                instrument.step()
        for _ in range(300):
            instrument.step()
        verdicts = [event.verdict for event in instrument.take_events() if isinstance(event, ScanFinished)]
        state = instrument.state.health
    assert len(verdicts) == 30
    assert {verdict.reason for verdict in verdicts} == {LIGHTS_UNKNOWN}
    assert set(state.light_change.values()) == {None}


def test_a_light_that_weakens_over_untouched_skin_is_no_contact(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore
) -> None:
    with Instrument(hardware, calibrated) as instrument:
        for _ in range(60):
            instrument.step()
        bench.faults.dimmed["blue"] = 0.9
        for _ in range(100):  # five seconds, for the check runs in another thread; without contact one is due every ten
            instrument.step()
            state = instrument.state
            if (state.health.light_change["blue"] or 0.0) < -0.05:
                break
        instrument.step()
        state = instrument.state
    assert state.health.light_change["blue"] == pytest.approx(-0.1, abs=0.003)
    assert state.live is not None
    assert state.live.reading.contact_fraction is None
    assert state.live.reading.advice == "lights"
