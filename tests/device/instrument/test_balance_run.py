"""The exposure balance of the whole instrument: what it finds, what it leaves alone, and when it is refused."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from device.acquisition.auto_exposure import AIMED_LEVEL, calibration_settings
from device.acquisition.capture import CaptureSettings
from device.bundles.scan import VerdictRecord
from device.instrument.calibration_run import KEPT, STOPPED
from device.instrument.events import Failed, Info, ScanFinished
from device.instrument.instrument import Instrument
from device.instrument.live import MAX_READING_S
from device.instrument.worker import NOT_NOW
from device.store.choices import BALANCE, with_active_gel
from device.store.store import BundleStore
from hal.hardware import Hardware
from hal.simulator.bench import SimulatedScene


def stepped(instrument: Instrument, steps: int = 6) -> list[str]:
    """What was said in some steps."""
    for _ in range(steps):
        instrument.step()
    return [event.sentence for event in instrument.take_events() if isinstance(event, (Failed, Info))]


def balanced(instrument: Instrument) -> list[str]:
    """Start the balance and let the twin's operator press its three balls; what was said."""
    instrument.start_balance()
    said = stepped(instrument)
    for _ in range(300):
        if instrument.state.activity != "balancing":
            break
        said += stepped(instrument, 1)
    return said + stepped(instrument)


@contextmanager
def running(hardware: Hardware, root: Path) -> Iterator[Instrument]:
    with Instrument(hardware, BundleStore(root, hardware.clock, boot_id="b0075e1f")) as instrument:
        stepped(instrument)
        yield instrument


def test_it_serves_the_next_calibration_and_leaves_the_active_one_alone(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore
) -> None:
    with running(hardware, calibrated.root) as instrument:
        active = instrument.state.calibration.calibration_id
        said = balanced(instrument)
        progress = instrument.state.balance
        assert progress is not None
        assert (progress.phase, progress.taken) == ("done", 3)
        assert any(KEPT in sentence for sentence in said)
        assert progress.found is not None
        assert progress.found.predicted == pytest.approx((AIMED_LEVEL,) * 3, rel=0.03)
        assert instrument.state.activity == "ready"
        assert instrument.state.calibration.calibration_id == active
        assert instrument.state.next_light is not None
        assert instrument.state.next_light.is_balanced
        fitted = with_active_gel(hardware, calibrated.root)
        assert calibration_settings(fitted, calibrated.root).currents_ma == progress.found.plan.currents_ma
        bench.place(None)
        bench.clock.sleep(1.0)
        stepped(instrument, 30)
        verdict = scanned(instrument)
        assert verdict.level == "good", verdict.reason
        instrument.start_calibration(3.0)
        for _ in range(2000):
            instrument.step()
            if instrument.state.activity == "ready":
                break
        assert instrument.state.calibration.calibration_id != active
        record = calibrated.active_calibration().record
        assert record.asked is not None
        assert record.asked.settings == progress.found.plan.settings
        assert {light.name: light.current_ma for light in record.fingerprint.lights} == progress.found.plan.currents_ma


def scanned(instrument: Instrument) -> VerdictRecord:
    """The verdict on a coin."""
    instrument.demonstrate("coin")
    for _ in range(400):
        instrument.step()
        for event in instrument.take_events():
            if isinstance(event, ScanFinished):
                return event.verdict
    raise AssertionError("no scan came of the demonstration")


def test_it_says_what_limits_it(bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore) -> None:
    bench.faults.dimmed = {"red": 0.1}
    with running(hardware, calibrated.root) as instrument:
        balanced(instrument)
        progress = instrument.state.balance
        assert progress is not None
        assert progress.found is not None, progress.instruction
        assert "Light red is weak: the exposure is longer" in progress.found.limit


def test_it_is_refused_during_a_calibration_and_refuses_others_meanwhile(
    hardware: Hardware, calibrated: BundleStore
) -> None:
    with running(hardware, calibrated.root) as instrument:
        instrument.start_calibration(3.0)
        stepped(instrument, 1)
        instrument.start_balance()
        assert NOT_NOW in stepped(instrument, 1)
        assert instrument.state.activity == "calibrating"
        instrument.cancel_run()
        stepped(instrument, 1)
        instrument.start_balance()
        stepped(instrument, 1)
        assert instrument.state.activity == "balancing"
        instrument.start_calibration(3.0)
        instrument.zero_check()
        assert stepped(instrument, 1).count(NOT_NOW) == 2
        instrument.cancel_run()
        assert STOPPED in stepped(instrument, 1)
        assert instrument.state.activity == "ready"
        assert not BALANCE.path(calibrated.root).exists()


def test_a_dead_light_ends_it_with_a_sentence_and_nothing_changed(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore
) -> None:
    bench.faults.open_lights = {"green"}
    with running(hardware, calibrated.root) as instrument:
        said = balanced(instrument)
        assert any("light green is hardly visible" in sentence for sentence in said)
        assert instrument.state.activity == "ready"
        assert not BALANCE.path(calibrated.root).exists()


def test_a_balance_of_another_gel_does_not_count_and_it_can_be_given_up(
    hardware: Hardware, calibrated: BundleStore
) -> None:
    with running(hardware, calibrated.root) as instrument:
        balanced(instrument)
        instrument.change_gel("gel-9", 2.0)
        stepped(instrument)
        assert instrument.state.next_light is not None
        assert not instrument.state.next_light.is_balanced
        instrument.change_gel("twin-gel")
        stepped(instrument)
        assert instrument.state.next_light.is_balanced
        instrument.forget_balance()
        said = stepped(instrument)
        assert "The next calibration uses the board profile's exposure and currents again." in said
        assert instrument.state.next_light.plan == CaptureSettings.of_board(hardware)


def test_the_light_on_the_skin_is_read_while_it_is_shown(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore
) -> None:
    with running(hardware, calibrated.root) as instrument:
        assert instrument.state.levels is None
        instrument.read_levels(True)
        stepped(instrument)
        healthy = instrument.state.levels
        assert healthy is not None
        assert max(healthy.clipped) < 0.01
        bench.faults.dimmed = {"blue": 0.5}
        stepped(instrument)
        dim = instrument.state.levels
        assert dim is not None
        assert dim.median[2] < 0.7 * healthy.median[2]
        assert dim.median[0] > 0.9 * healthy.median[0]
        bench.faults.dimmed, bench.faults.ambient = {}, 0.9
        stepped(instrument)
        assert instrument.state.levels is not None
        assert max(instrument.state.levels.clipped) > 0.5
        bench.faults.ambient = 0.0
        bench.clock.sleep(1.1 * MAX_READING_S)
        stepped(instrument, 1)
        assert instrument.state.levels is None
