"""Every fault of the demonstration is shown by the whole instrument, and is gone when it is switched off."""

import pytest

from device.bundles.scan import VerdictRecord
from device.instrument.demo_faults import DEMO_FAULTS, DemoDisk, DemoFault, DemoFaults
from device.instrument.events import PressRefused, ScanFinished
from device.instrument.instrument import Instrument
from device.store.store import BundleStore
from hal.hardware import Hardware

EXPECTED: dict[DemoFault, str] = {
    "dim": "light blue is 10.0% weaker",
    "break": "light blue is at",
    "wobble": "the contact moved during the exposure",
    "dirt": "of the skin is scratched or dirty",
    "tilt": "tilted by",
    "depth": "too deep",
}


def demonstrated(instrument: Instrument, name: str) -> VerdictRecord | str:
    """The verdict on an object that the twin's operator presses, or why it was refused."""
    for _ in range(30):
        instrument.step()
    instrument.take_events()
    instrument.demonstrate(name)
    for _ in range(400):
        instrument.step()
        for event in instrument.take_events():
            if isinstance(event, ScanFinished):
                return event.verdict
            if isinstance(event, PressRefused):
                return event.sentence
    raise AssertionError("no scan came of the demonstration")


@pytest.fixture
def demo_store(calibrated: BundleStore, hardware: Hardware) -> tuple[BundleStore, DemoDisk]:
    disk = DemoDisk()
    return BundleStore(calibrated.root, hardware.clock, boot_id="b0075e1f", statvfs=disk), disk


@pytest.mark.parametrize("fault", EXPECTED)
def test_a_fault_is_said_by_the_verdict_and_gone_when_switched_off(
    hardware: Hardware, demo_store: tuple[BundleStore, DemoDisk], fault: DemoFault
) -> None:
    store, disk = demo_store
    with Instrument(hardware, store) as instrument:
        faults = DemoFaults(instrument, disk)
        faults.toggle(fault)
        verdict = demonstrated(instrument, "coin")
        assert isinstance(verdict, VerdictRecord)
        assert verdict.level != "good"
        assert EXPECTED[fault] in verdict.reason
        faults.toggle(fault)
        assert faults.active == set()
        after = demonstrated(instrument, "coin")
        assert isinstance(after, VerdictRecord)
        assert after.level == "good", after.reason


def test_battery_and_storage_raise_their_alarms(hardware: Hardware, demo_store: tuple[BundleStore, DemoDisk]) -> None:
    store, disk = demo_store
    with Instrument(hardware, store) as instrument:
        faults = DemoFaults(instrument, disk)
        faults.toggle("battery")
        faults.toggle("storage")
        refused = demonstrated(instrument, "coin")
        assert isinstance(refused, str)
        assert "no room" in refused
        for _ in range(400):
            instrument.step()
        assert any("battery at 8%" in alarm for alarm in instrument.state.alarms)
        assert any("no room" in alarm for alarm in instrument.state.alarms)


def test_every_fault_is_tested() -> None:
    assert {name for name, _ in DEMO_FAULTS} == {*EXPECTED, "battery", "storage"}
