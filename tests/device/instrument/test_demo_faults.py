"""Every fault of the demonstration is shown by the whole instrument, and is gone when it is switched off."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from device.bundles.scan import VerdictRecord
from device.instrument.demo_faults import DEMO_FAULTS, DemoDisk, DemoFault, DemoFaults
from device.instrument.events import Failed, PressRefused, ScanFinished
from device.instrument.instrument import Instrument
from device.store.store import BundleStore
from hal.board_profile import BoardProfile
from hal.clock import VirtualClock
from hal.hardware import Hardware
from hal.simulator.bench import build
from hal.simulator.hardware import twin_hardware

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
    disk = DemoDisk(calibrated.root)
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


def test_a_full_store_is_exported_to_a_stick(
    hardware: Hardware, demo_store: tuple[BundleStore, DemoDisk], tmp_path: Path
) -> None:
    store, disk = demo_store
    stick = tmp_path / "stick"
    stick.mkdir()
    with Instrument(hardware, store, stick=lambda: stick) as instrument:
        assert isinstance(demonstrated(instrument, "coin"), VerdictRecord)
        DemoFaults(instrument, disk).toggle("storage")
        refused = demonstrated(instrument, "coin")
        assert isinstance(refused, str)
        exported = instrument.export_to_stick()
        assert (exported.verified, exported.copied, exported.failed) == (1, 1, ())


class WatchedClock(VirtualClock):
    """A virtual clock that calls `watch` whenever time passes."""

    def __init__(self) -> None:
        super().__init__(start_ns=5_000_000_000, wall_start_s=1_000.0)
        self.watch: Callable[[], None] = lambda: None

    def sleep(self, duration_s: float) -> None:
        self.watch()
        super().sleep(duration_s)


def test_a_stall_is_one_steady_sentence_within_a_second_and_leaves_nothing_behind(
    small_twin: BoardProfile, calibrated_root: Path, tmp_path: Path
) -> None:
    clock, disk = WatchedClock(), DemoDisk(tmp_path / "store")
    hardware = twin_hardware(build(small_twin, clock))
    shutil.copytree(calibrated_root, tmp_path / "store")
    store = BundleStore(tmp_path / "store", clock, boot_id="b0075e1f", statvfs=disk)
    with Instrument(hardware, store) as instrument:
        faults = DemoFaults(instrument, disk)
        assert isinstance(demonstrated(instrument, "coin"), VerdictRecord)
        for _ in range(10):
            instrument.step()
        instrument.take_events()
        seen: list[tuple[float, str, str, bool]] = []
        began_ns = clock.monotonic_ns()

        def watch() -> None:
            state = instrument.state
            seen.append(((clock.monotonic_ns() - began_ns) * 1e-9, state.activity, state.sentence, state.live is None))

        clock.watch = watch
        faults.toggle("stall")
        while clock.monotonic_ns() - began_ns < 10_000_000_000:
            instrument.step()
        first = next(index for index, (_, activity, _, _) in enumerate(seen) if activity == "out of order")
        assert seen[first][0] < 1.0
        assert len({said[1:] for said in seen[first:]}) == 1
        assert seen[-1][3], "a live picture is shown of a stalled camera"
        assert "delivers no frame" in seen[-1][2]
        assert [type(event) for event in instrument.take_events()] == [Failed]
        faults.toggle("stall")
        for _ in range(5):
            instrument.step()
        assert instrument.state.activity == "ready"
        assert "delivers no frame" not in instrument.state.sentence
        after = demonstrated(instrument, "coin")
        assert isinstance(after, VerdictRecord)
        assert after.level == "good", after.reason


def test_every_fault_is_tested() -> None:
    assert {name for name, _ in DEMO_FAULTS} == {*EXPECTED, "battery", "storage", "stall"}
