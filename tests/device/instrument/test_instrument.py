"""The instrument without a front end, on the twin in virtual time: presses, refusals, calibration, gel, history."""

import socket
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from pathlib import Path
from typing import Any

import pytest

import device.store.store
from device.bundles.scan import Annotations
from device.instrument.events import (
    CalibrationStep,
    CaptureDone,
    Event,
    Failed,
    Info,
    PairingChanged,
    PowerOffRequested,
    PressRefused,
    PressSeen,
    ScanFinished,
    SelfTested,
    ZeroChecked,
)
from device.instrument.instrument import Instrument
from device.instrument.state import PairingState
from device.pairing import (
    Accepted,
    Answer,
    Call,
    HostCard,
    Opening,
    PairingChannel,
    code_of,
    commitment_to,
    draw_number,
)
from device.pairing_service import PairingSetup
from device.store.choices import make_gel, mount_gel
from device.store.store import BundleStore
from hal.hardware import Hardware
from hal.interfaces import ButtonPress
from hal.simulator.bench import SimulatedScene
from hal.simulator.operator import specimen
from hal.simulator.scene import Press

SECOND = 1_000_000_000


class Later(Executor):
    """Runs jobs only on demand: a slow disk."""

    def __init__(self) -> None:
        self.jobs: list[tuple[Future[Any], Callable[[], Any]]] = []

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        self.jobs.append((future, lambda: fn(*args, **kwargs)))
        return future

    def run_all(self) -> None:
        while self.jobs:
            future, job = self.jobs.pop(0)
            future.set_result(job())


@pytest.fixture
def instrument(hardware: Hardware, calibrated: BundleStore) -> Iterator[Instrument]:
    with Instrument(hardware, calibrated) as ready:
        yield ready


def events_of(instrument: Instrument, steps: int) -> list[Event]:
    for _ in range(steps):
        instrument.step()
    return list(instrument.take_events())


def put(bench: SimulatedScene, name: str) -> None:
    shown = specimen(name)
    bench.place(Press(shown.surface, (0.0, 0.0), 0.0, shown.indentation_mm))


def push(bench: SimulatedScene, in_s: float = 0.1, held_s: float = 0.05) -> None:
    bench.schedule_button(ButtonPress(bench.clock.monotonic_ns() + round(in_s * SECOND), held_s))


def only(events: list[Event], kind: type[Any]) -> Any:
    (found,) = [event for event in events if isinstance(event, kind)]
    return found


def test_a_push_becomes_a_scan_with_cues_in_time(
    instrument: Instrument, bench: SimulatedScene, calibrated: BundleStore
) -> None:
    instrument.set_sticky(Annotations(job="casting 7", operator="Ada"))
    events_of(instrument, 16)  # untouched skin, for the lights
    put(bench, "coin")
    events_of(instrument, 5)
    push(bench)
    pushed_ns = bench.clock.monotonic_ns() + SECOND // 10
    events = events_of(instrument, 4)
    bench.place(None)
    events += events_of(instrument, 24)
    assert only(events, PressSeen).latency_ms <= 100.0
    assert only(events, CaptureDone).at_ns - pushed_ns <= 0.5 * SECOND
    finished = only(events, ScanFinished)
    assert finished.at_ns - pushed_ns <= 1.5 * SECOND
    assert finished.height is not None
    assert [cue for _, cue in bench.cues] == ["idle", "busy", "may lift", "good"]
    (scan,) = calibrated.scans().bundles
    assert scan.record.annotations == Annotations(job="casting 7", operator="Ada")
    assert scan.record.verdict.figures["motion"] is not None
    assert instrument.state.scans_stored == 1
    assert instrument.state.gel.presses == 1


def test_the_next_press_is_taken_while_the_last_is_processed_and_a_third_is_refused(
    hardware: Hardware, calibrated: BundleStore, bench: SimulatedScene
) -> None:
    slow_disk = Later()
    with Instrument(hardware, calibrated, slow_disk) as instrument:
        for number in range(3):
            push(bench, 0.1 + 0.3 * number)
        events = events_of(instrument, 25)
        assert sum(isinstance(event, CaptureDone) for event in events) == 2
        assert instrument.state.processing == 2
        refused = only(events, PressRefused)
        assert refused.reason == "busy"
        assert "push again" in refused.sentence
        assert bench.cues[-1][1] == "refused"
        slow_disk.run_all()  # the verdicts
        events_of(instrument, 1)
        slow_disk.run_all()  # the disk
        assert sum(isinstance(event, ScanFinished) for event in events_of(instrument, 1)) == 2
        assert instrument.state.processing == 0
    assert len(calibrated.scans().bundles) == 2


def test_a_double_press_is_one_scan_and_a_refusal(instrument: Instrument, bench: SimulatedScene) -> None:
    events_of(instrument, 3)
    push(bench, 0.0, held_s=0.001)
    push(bench, 0.004, held_s=0.001)
    events = events_of(instrument, 6)
    only(events, ScanFinished)
    assert "was ignored while the frame was being taken: push again" in only(events, PressRefused).sentence


def test_a_scan_that_is_not_possible_is_refused_with_the_reason(
    hardware: Hardware, tmp_path: Path, bench: SimulatedScene
) -> None:
    with Instrument(hardware, BundleStore(tmp_path / "empty", hardware.clock)) as instrument:
        instrument.press()
        refused = only(events_of(instrument, 2), PressRefused)
        assert refused.reason == "calibration"
        assert bench.cues[-1][1] == "refused: calibration"
        assert "retroscan calibrate" in refused.sentence
        assert "retroscan calibrate" in instrument.state.calibration.fault


def test_a_full_disk_refuses_before_the_press(
    instrument: Instrument, monkeypatch: pytest.MonkeyPatch, bench: SimulatedScene, calibrated: BundleStore
) -> None:
    monkeypatch.setattr(device.store.store, "RESERVE_BYTES", 1 << 62)
    push(bench)
    events = events_of(instrument, 6)
    assert only(events, PressRefused).reason == "full"
    assert bench.cues[-1][1] == "refused: full"
    assert not any(isinstance(event, CaptureDone) for event in events)
    assert calibrated.scans().bundles == ()


def test_a_calibration_guides_fills_up_and_passes_within_three_minutes(
    hardware: Hardware, tmp_path: Path, bench: SimulatedScene
) -> None:
    store = BundleStore(tmp_path / "fresh", hardware.clock)
    with Instrument(hardware, store) as instrument:
        began_ns = bench.clock.monotonic_ns()
        instrument.start_calibration(3.0)
        steps: list[CalibrationStep] = []
        while not steps or not steps[-1].progress.is_over:
            steps += [event for event in events_of(instrument, 5) if isinstance(event, CalibrationStep)]
        assert bench.clock.monotonic_ns() - began_ns < 180 * SECOND
        covered = [sum(s.progress.coverage.sectors.values()) for s in steps if s.progress.coverage]
        assert covered == sorted(covered)
        assert covered[-1] == 9
        assert all(len(s.progress.circles) == 1 for s in steps if s.progress.accepted)
        last = steps[-1].progress
        assert last.phase == "passed"
        assert all(check.passed for check in last.checks)
        assert instrument.state.calibration.calibration_id == last.calibration_id
        assert (instrument.state.calibration.version, instrument.state.calibration.slot) == (1, "user")
        instrument.start_calibration(3.0)
        events_of(instrument, 1)
        instrument.cancel_run()
        events_of(instrument, 1)
        assert instrument.state.calibration.calibration_id == last.calibration_id


def test_a_push_that_a_calibration_asked_for_and_did_not_need_takes_no_scan(
    hardware: Hardware, tmp_path: Path, bench: SimulatedScene
) -> None:
    store = BundleStore(tmp_path / "fresh", hardware.clock)
    with Instrument(hardware, store) as instrument:
        instrument.start_calibration(3.0)
        events = events_of(instrument, 1)
        while instrument.state.activity == "calibrating":
            instrument.press()  # by the screen, before the operator's own push
            events += events_of(instrument, 10)
        assert instrument.state.guide is not None
        assert instrument.state.guide.phase == "passed"
        events += events_of(instrument, 100)
        assert bench.next_button_press() is None
    assert not [event for event in events if isinstance(event, (PressSeen, ScanFinished))]


def test_zero_is_checked_in_air_in_micrometres(instrument: Instrument, bench: SimulatedScene) -> None:
    instrument.zero_check()
    checked = only(events_of(instrument, 2), ZeroChecked)
    assert checked.passed
    assert 0.0 < checked.flat_residual_um < 8.0
    assert instrument.state.health.flat_residual_um == checked.flat_residual_um
    before = instrument.state.health
    put(bench, "coin")
    instrument.zero_check()
    failed = only(events_of(instrument, 2), ZeroChecked)
    assert not failed.passed
    assert "µm" in failed.sentence
    after = instrument.state.health
    # A frame that is touched all the same updates neither lights nor defects.
    assert (after.light_change, after.defect_fraction) == (before.light_change, before.defect_fraction)


def test_another_gel_is_refused_until_it_is_calibrated_and_the_first_comes_back(instrument: Instrument) -> None:
    first = instrument.state.calibration.calibration_id
    instrument.change_gel("soft-2", 4.0)
    sentence = only(events_of(instrument, 2), Failed).sentence
    assert "gel soft-2 has no calibration" in sentence
    assert "twin-gel" in sentence
    instrument.press()
    refused = only(events_of(instrument, 2), PressRefused)
    assert refused.reason == "calibration"
    assert "soft-2" in refused.sentence
    instrument.change_gel("twin-gel")
    assert "is active" in only(events_of(instrument, 2), Info).sentence
    assert instrument.state.calibration.calibration_id == first
    assert {gel.gel_id: gel.slab_thickness_mm for gel in instrument.gels()} == {"soft-2": 4.0, "twin-gel": 2.5}


def test_scans_are_reviewed_marked_and_noted(instrument: Instrument) -> None:
    for _ in range(2):
        instrument.press()
        events_of(instrument, 2)
    newest, oldest = instrument.history().scans
    assert newest.counter > oldest.counter
    assert not newest.offloaded
    instrument.mark(oldest.scan_id, "bad", "hair on the gel")
    marked = instrument.history().scans[1].mark
    assert marked is not None
    assert (marked.opinion, marked.note) == ("bad", "hair on the gel")
    look = instrument.quick_look(newest.scan_id)
    assert look is not None
    assert look.z_um.shape == (136, 182)
    assert look.pitch_um == pytest.approx(96.0)


def test_the_auto_shutter_fires_once_a_contact_when_it_is_still(instrument: Instrument, bench: SimulatedScene) -> None:
    instrument.set_auto_shutter(True)
    assert not any(isinstance(event, ScanFinished) for event in events_of(instrument, 20))
    put(bench, "coin")
    events = events_of(instrument, 40)
    assert only(events, PressSeen).source == "auto-shutter"
    bench.place(None)
    only(events_of(instrument, 30), ScanFinished)
    put(bench, "coin")
    only(events_of(instrument, 20), PressSeen)


def test_the_self_test_runs_from_within_and_the_next_press_scans(instrument: Instrument, bench: SimulatedScene) -> None:
    bench.faults.open_lights.add("green")
    instrument.run_selftest()
    found = [event for event in events_of(instrument, 1) if isinstance(event, SelfTested)]
    assert [event.finding.part for event in found if event.finding.state == "failed"] == ["light green"]
    assert [event.ended for event in found] == [False] * (len(found) - 1) + [True]
    bench.faults.open_lights.clear()
    instrument.press()
    only(events_of(instrument, 2), ScanFinished)


def test_a_missing_camera_is_reported_once_and_used_when_it_is_back(
    hardware: Hardware, calibrated: BundleStore, bench: SimulatedScene
) -> None:
    bench.faults.camera_missing = True
    with Instrument(hardware, calibrated) as instrument:
        events = events_of(instrument, 4)
        assert "is not there" in only(events, Failed).sentence
        assert instrument.state.activity == "out of order"
        bench.faults.camera_missing = False
        instrument.press()
        only(events_of(instrument, 3), ScanFinished)


def test_idle_lights_go_dark_and_a_push_wakes_them(instrument: Instrument, bench: SimulatedScene) -> None:
    events_of(instrument, 3)
    assert bench.currents_ma
    bench.clock.sleep(130.0)
    events_of(instrument, 2)
    assert bench.currents_ma == {}
    assert instrument.state.live is None
    push(bench)
    assert not any(isinstance(event, ScanFinished) for event in events_of(instrument, 6))
    assert instrument.state.live is not None
    push(bench)
    only(events_of(instrument, 6), ScanFinished)


def test_power_off_leaves_nothing_lit_and_nothing_unwritten(
    instrument: Instrument, bench: SimulatedScene, calibrated: BundleStore
) -> None:
    instrument.press()
    instrument.power_off()
    events = events_of(instrument, 2)
    assert isinstance(events[-1], PowerOffRequested)
    assert bench.currents_ma == {}
    assert len(calibrated.scans().bundles) == 1
    assert instrument.state.activity == "off"


def test_the_pairing_window_opens_on_a_long_push_and_closes(
    hardware: Hardware, calibrated: BundleStore, bench: SimulatedScene, tmp_path: Path
) -> None:
    key = tmp_path / "host_key.pub"
    key.write_text("ssh-ed25519 AAAAC3NzaC1lZDI1NTE5AAAAIJ5mZ2Vuc2VsYmFyZXJzY2hsdWVzc2VsMDEyMzQ1 root@handheld\n")
    setup = PairingSetup(port=0, host_key=key, keys=tmp_path)
    with Instrument(hardware, calibrated, pairing=setup) as instrument:
        push(bench, held_s=2.5)
        events = events_of(instrument, 60)
        assert not any(isinstance(event, ScanFinished) for event in events)
        opened = only(events, PairingChanged)
        assert opened.is_open
        assert bench.cues[-1][1] == "pairing"
        assert instrument.state.pairing is not None
        assert "retrosync pair" in opened.sentence
        bench.clock.sleep(121.0)
        assert not only(events_of(instrument, 1), PairingChanged).is_open
        assert instrument.network().key_fingerprint.startswith("SHA256:")
    assert calibrated.scans().bundles == ()


def step_until(instrument: Instrument, reached: Callable[[PairingState], bool]) -> list[Event]:
    """Step until pairing is there, which has threads in real time, and long before its two minutes are over."""
    events: list[Event] = []
    for _ in range(4000):
        if instrument.state.pairing and reached(instrument.state.pairing):
            return events
        instrument.step()
        events += instrument.take_events()
        threading.Event().wait(0.005)
    pytest.fail("pairing went no further")


def test_a_held_button_confirms_the_code_that_is_shown_and_calibrates_nothing(
    hardware: Hardware, calibrated: BundleStore, bench: SimulatedScene, tmp_path: Path
) -> None:
    key = tmp_path / "host_key.pub"
    key.write_text("ssh-ed25519 AAAAC3NzaC1lZDI1NTE5AAAAIJ5mZ2Vuc2VsYmFyZXJzY2hsdWVzc2VsMDEyMzQ1 root@handheld\n")
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    host = HostCard(name="bench", public_key="ssh-ed25519 " + "A" * 68)
    number = draw_number()
    with Instrument(hardware, calibrated, pairing=PairingSetup(port, host_key=key, keys=tmp_path)) as instrument:
        instrument.open_pairing_when_new()
        events_of(instrument, 1)
        with socket.create_connection(("127.0.0.1", port)) as connection:
            channel = PairingChannel(connection, 10.0)
            channel.send(Call(card=host, commitment=commitment_to(host, number)))
            answer = channel.receive(Answer)
            channel.send(Opening(number=number))
            step_until(instrument, lambda pairing: bool(pairing.code))
            code = code_of(host, answer.card, number, answer.number)
            assert instrument.state.pairing.code == code
            assert f"Code {code} for bench" in instrument.state.pairing.sentence
            push(bench, held_s=2.5)
            events = step_until(instrument, lambda pairing: not pairing.is_open)
            channel.receive(Accepted)
        assert instrument.state.pairing.sentence == "paired with bench"
        instrument.open_pairing_when_new()
        assert not any(isinstance(event, (CalibrationStep, ScanFinished)) for event in events)
        assert events_of(instrument, 5) == [] or not instrument.state.pairing.is_open
    assert (tmp_path / "authorized_keys").read_text() == f"restrict {host.public_key} bench\n"


def test_the_calibrations_age_grows_while_the_instrument_is_on(instrument: Instrument, hardware: Hardware) -> None:
    hardware.clock.sleep(3600.0)  # the calibration was made later than this world begins
    instrument.step()
    begun_s = instrument.state.calibration.age_s
    assert begun_s is not None
    hardware.clock.sleep(3600.0)
    instrument.step()
    assert instrument.state.calibration.age_s == pytest.approx(begun_s + 3600.0, abs=2.0)


def test_a_gel_that_another_program_mounted_is_scanned_under_no_other_gels_calibration(
    instrument: Instrument, calibrated: BundleStore, hardware: Hardware
) -> None:
    usual = hardware.profile.gel
    mount_gel(calibrated.root, make_gel("soft-2", 2.0))
    instrument.press()
    assert only(events_of(instrument, 2), PressRefused).reason == "calibration"
    assert instrument.state.gel.gel_id == "soft-2"
    mount_gel(calibrated.root, make_gel(usual.id, usual.slab_thickness_mm))
    instrument.press()
    assert "Changed by another program" in only(events_of(instrument, 2), Info).sentence
    assert [bundle.record.gel_id for bundle in calibrated.scans().bundles] == [usual.id]
