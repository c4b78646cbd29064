"""Parts that stop answering and come back: nothing is mistaken for something else, and what is shown is true."""

import pytest

import device.store.store
from device.instrument.events import (
    CalibrationStep,
    Failed,
    Info,
    PairingChanged,
    PowerOffRequested,
    PressRefused,
    ScanFinished,
)
from device.instrument.health import alarms
from device.instrument.instrument import Instrument
from device.store.store import BundleStore
from hal.hardware import Hardware
from hal.interfaces import ButtonPress, PowerReading
from hal.simulator.bench import SimulatedScene


def test_a_short_push_during_a_dropout_does_not_become_a_long_one(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore
) -> None:
    with Instrument(hardware, calibrated) as instrument:
        for _ in range(2):
            for _ in range(5):
                instrument.step()
            instrument.take_events()
            bench.schedule_button(ButtonPress(bench.clock.monotonic_ns() + 20_000_000, 0.3))
            instrument.step()
            bench.faults.lights_silent = True
            for _ in range(4):
                instrument.step()
            assert instrument.state.activity == "out of order"
            bench.faults.lights_silent = False
            for _ in range(60):
                instrument.step()
            events = instrument.take_events()
            assert instrument.state.activity == "ready"
            assert not any(isinstance(event, (PairingChanged, CalibrationStep, ScanFinished)) for event in events)
            assert any("push again" in event.sentence for event in events if isinstance(event, PressRefused))
    assert calibrated.scans().bundles == ()


def test_a_stalled_camera_is_one_steady_sentence_within_a_second_and_goes_with_the_stall(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore
) -> None:
    with Instrument(hardware, calibrated) as instrument:
        for _ in range(5):
            instrument.step()
        instrument.take_events()
        bench.faults.camera_stalled = True
        began_ns, shown = bench.clock.monotonic_ns(), []
        while bench.clock.monotonic_ns() - began_ns < 12_000_000_000:
            instrument.step()
            shown.append((bench.clock.monotonic_ns(), instrument.state.activity, instrument.state.sentence))
        first_ns = next(at_ns for at_ns, activity, _ in shown if activity == "out of order")
        assert {(activity, sentence) for at_ns, activity, sentence in shown if at_ns >= first_ns} == {
            ("out of order", instrument.state.sentence)
        }
        assert first_ns - began_ns < 2_000_000_000  # reported after 0.8 s, then the turn waits a second to retry
        assert "delivers no frame" in instrument.state.sentence
        assert [type(event) for event in instrument.take_events()] == [Failed]
        bench.faults.camera_stalled = False
        for _ in range(4):
            instrument.step()
        assert instrument.state.activity == "ready"
        assert "delivers no frame" not in instrument.state.sentence
        assert any(isinstance(event, Info) for event in instrument.take_events())


def test_battery_alarms_are_announced_once_each_and_an_empty_one_stops_in_order(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore
) -> None:
    heard: list[str] = []
    with Instrument(hardware, calibrated) as instrument:
        for charge in (0.5, 0.21, 0.2, 0.19, 0.1, 0.09, 0.05, 0.04, 0.04):
            bench.faults.battery_share = charge
            bench.clock.sleep(6.0)
            instrument.step()
            events = instrument.take_events()
            heard += [event.sentence for event in events if isinstance(event, Failed)]
        assert heard == [
            "battery at 20%: charge it soon",
            "battery at 10%: charge it now",
            "battery at 5%: the instrument switches itself off",
        ]
        assert any(isinstance(event, PowerOffRequested) for event in events)
        assert instrument.state.activity == "off"
    assert bench.currents_ma == {}


def test_little_room_is_said_and_no_room_is_never_ready(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    with Instrument(hardware, calibrated) as instrument:
        instrument.step()
        assert instrument.state.alarms == ()
        monkeypatch.setattr(device.store.store, "RESERVE_BYTES", 1 << 62)
        bench.clock.sleep(6.0)
        instrument.step()
        assert instrument.state.scans_left == 0
        assert "no room for another scan" in instrument.state.alarms[0]
        assert any("no room" in event.sentence for event in instrument.take_events() if isinstance(event, Failed))
    assert alarms(PowerReading(), 51) == ()
    assert alarms(PowerReading(), 50) == ("room for 50 more scans: offload soon",)
