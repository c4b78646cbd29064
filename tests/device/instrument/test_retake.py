"""What becomes of a retake when something comes between: the button, a check, a deletion, a press being judged."""

from msgspec import structs

from device.bundles.check import CheckStandard
from device.bundles.scan import Annotations
from device.instrument.events import CaptureDone, Failed
from device.instrument.instrument import Instrument
from device.store.store import BundleStore
from hal.hardware import Hardware
from hal.interfaces import ButtonPress
from hal.simulator.bench import SimulatedScene
from hal.simulator.scene import Press
from hal.simulator.surfaces import Sphere
from tests.apparatus.random_presses import WHOLE_FIELD_OBJECTS
from tests.device.instrument.test_scan_keeping import numbers, scanned

BALL = CheckStandard(name="ball 3", kind="ball", value_um=3000.0, tolerance_um=2.0)


def push_until_captured(instrument: Instrument, bench: SimulatedScene, press: Press) -> None:
    """A push that is still held when this returns; the frame is taken."""
    for _ in range(24):
        instrument.step()
    bench.place(press)
    instrument.take_events()
    bench.schedule_button(ButtonPress(bench.clock.monotonic_ns() + 100_000_000, 0.6))
    for _ in range(40):
        instrument.step()
        if any(isinstance(event, CaptureDone) for event in instrument.take_events()):
            return
    raise AssertionError("no frame was taken")


def step_until_stored(instrument: Instrument, bench: SimulatedScene, count: int) -> None:
    bench.place(None)
    for _ in range(600):
        instrument.step()
        if len(instrument.history().scans) >= count and not instrument.state.processing:
            return
    raise AssertionError("the press was not stored")


def press_standard(instrument: Instrument, bench: SimulatedScene) -> None:
    """The second scan: a check."""
    instrument.begin_check()
    for _ in range(24):
        instrument.step()
    bench.place(Press(Sphere(3.0), (0.0, 0.0), 0.0, 0.5))
    instrument.press()
    instrument.step()
    step_until_stored(instrument, bench, 2)


def replaced(store: BundleStore) -> list[str | None]:
    """What each scan's record says it replaces, oldest first."""
    scans = sorted(store.scans().bundles, key=lambda bundle: bundle.record.identity.counter)
    return [bundle.record.replaces for bundle in scans]


def test_a_retake_asked_for_during_a_press_is_of_the_next_press(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore
) -> None:
    with Instrument(hardware, calibrated) as instrument:
        first = scanned(instrument, bench)
        push_until_captured(instrument, bench, Press(Sphere(4.0), (0.0, 0.0), 0.0, 0.5))
        instrument.retake()
        step_until_stored(instrument, bench, 2)
        assert numbers(instrument) == [2, 1]
        assert instrument.state.replaces is not None
        assert instrument.state.replaces.scan_id == first.scan_id
        scanned(instrument, bench)
        assert numbers(instrument) == [3, 2]
        assert replaced(calibrated) == [None, first.scan_id]


def test_a_retake_called_off_during_its_press_still_replaces(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore
) -> None:
    with Instrument(hardware, calibrated) as instrument:
        first = scanned(instrument, bench)
        instrument.retake()
        push_until_captured(instrument, bench, Press(Sphere(4.0), (0.0, 0.0), 0.0, 0.5))
        instrument.retake()
        for _ in range(300):
            bench.place(None)
            instrument.step()
        assert replaced(calibrated) == [first.scan_id]
        assert instrument.state.replaces is None


def test_a_check_between_leaves_the_retake_its_labels_and_its_level(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore
) -> None:
    with Instrument(hardware, calibrated) as instrument:
        instrument.set_sticky(Annotations(job="lids", part="A-09"))
        instrument.set_settings(structs.replace(instrument.state.settings, number_parts=True))
        instrument.set_standard(BALL)
        first = scanned(instrument, bench)
        instrument.retake()
        press_standard(instrument, bench)
        assert [check.passed for check in instrument.state.check.checks] == [True]
        again = scanned(instrument, bench, depth_mm=0.02)
        assert again.verdict.level == "doubtful"
        assert numbers(instrument) == [3, 2, 1]
        newest = instrument.history().scans[0]
        assert newest.annotations.part == "A-09"
        assert replaced(calibrated) == [None, None, None]
        instrument.delete(first.scan_id)
        assert instrument.state.sticky.part == "A-10"


def test_a_deleted_scan_is_not_taken_again_although_another_came_after_it(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore
) -> None:
    with Instrument(hardware, calibrated) as instrument:
        instrument.set_standard(BALL)
        first = scanned(instrument, bench)
        instrument.retake()
        press_standard(instrument, bench)
        check = instrument.state.last
        assert check is not None
        instrument.delete(check.scan_id)
        assert instrument.state.replaces is not None
        instrument.delete(first.scan_id)
        assert instrument.state.replaces is None


def test_a_scan_that_is_still_judged_is_not_taken_again(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore
) -> None:
    with Instrument(hardware, calibrated) as instrument:
        scanned(instrument, bench)
        for _ in range(24):
            instrument.step()
        surface, depth_mm = WHOLE_FIELD_OBJECTS["whole-weave"]
        bench.place(Press(surface, (0.0, 0.0), 0.0, depth_mm))
        instrument.press()
        for _ in range(3):
            instrument.step()
        assert instrument.state.processing == 1
        instrument.take_events()
        instrument.retake()
        (refused,) = [event.sentence for event in instrument.take_events() if isinstance(event, Failed)]
        assert "still being judged" in refused
        assert instrument.state.replaces is None
        step_until_stored(instrument, bench, 2)
        instrument.retake()
        assert instrument.state.replaces is not None
        assert instrument.state.replaces.counter == 2


def test_a_replaced_scan_that_is_brought_back_says_so(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore
) -> None:
    with Instrument(hardware, calibrated) as instrument:
        first = scanned(instrument, bench)
        instrument.retake()
        scanned(instrument, bench)
        assert instrument.undo_delete() == first.scan_id
        assert [entry.replaced_by for entry in instrument.history().scans] == [None, 2]
