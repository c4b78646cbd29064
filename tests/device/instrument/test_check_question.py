"""A ball that reads as another common one is a question where an operator can answer, and a failed check elsewhere."""

import pytest

from device.instrument.events import CheckAsked, Checked, Info, ScanFinished
from device.instrument.instrument import Instrument
from device.store.checks import read_checks
from device.store.store import BundleStore
from hal.hardware import Hardware
from hal.interfaces import ButtonPress
from hal.simulator.bench import SimulatedScene
from hal.simulator.scene import Press
from hal.simulator.surfaces import Sphere
from tests.device.instrument.test_check_standard import STANDARDS, checked, pressed

BALL, RIGHT, DEPTH_MM = STANDARDS["ball"]
PLACE = (0.3, -0.2)


def asked(instrument: Instrument, bench: SimulatedScene, radius_mm: float) -> str:
    """The question that a check of a ball ends in; empty if it is judged without one."""
    if not instrument.state.check.is_next:
        instrument.begin_check()
        instrument.step()
    for _ in range(24):
        instrument.step()
    instrument.take_events()
    bench.place(Press(Sphere(radius_mm), PLACE, 0.0, DEPTH_MM))
    bench.schedule_button(ButtonPress(bench.clock.monotonic_ns() + 100_000_000, 0.05))
    for _ in range(12):
        instrument.step()
    bench.place(None)
    for _ in range(600):
        instrument.step()
        for event in instrument.take_events():
            if isinstance(event, CheckAsked):
                return event.question
            if isinstance(event, ScanFinished):
                return ""
    raise AssertionError("nothing came of the push")


def test_a_look_alike_is_asked_about_and_repeated_or_failed(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore
) -> None:
    with Instrument(hardware, calibrated) as instrument:
        instrument.ask_about_checks()
        instrument.set_standard(BALL)
        instrument.step()
        question = asked(instrument, bench, 2.5)
        assert question.startswith("The ball reads radius 2.")
        assert "mm; the check standard is 3.00 mm. Is the right ball on the gel?" in question
        assert instrument.state.processing == 1
        instrument.answer_check(is_standard=False)
        instrument.step()
        assert instrument.state.processing == 0
        assert Info("Press ball 3, then push.") in instrument.take_events()
        assert instrument.state.check.is_next
        assert instrument.state.check.is_due
        assert not read_checks(calibrated.root)
        assert not calibrated.scans().bundles
        result = next(
            event for event in pressed(instrument, bench, RIGHT, DEPTH_MM, PLACE) if isinstance(event, Checked)
        )
        assert result.passed, result.sentence
        assert asked(instrument, bench, 2.5)
        instrument.answer_check(is_standard=True)
        for _ in range(4):
            instrument.step()
        (failed,) = [event for event in instrument.take_events() if isinstance(event, Checked)]
        assert not failed.passed
        assert "it reads as a ball of 2.5 mm" in failed.sentence
        (after,) = [
            event
            for event in pressed(instrument, bench, Sphere(4.0), DEPTH_MM, (0.0, 0.0))
            if isinstance(event, ScanFinished)
        ]
        assert "check of ball 3 FAILED" in after.verdict.reason
    assert [check.passed for check in read_checks(calibrated.root)] == [True, False]


@pytest.mark.parametrize("radius_mm", [2.65, 3.0])
def test_what_is_not_clearly_another_common_ball_is_judged_at_once(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore, radius_mm: float
) -> None:
    with Instrument(hardware, calibrated) as instrument:
        instrument.ask_about_checks()
        instrument.set_standard(BALL)
        instrument.step()
        assert asked(instrument, bench, radius_mm) == ""
    (check,) = read_checks(calibrated.root)
    assert check.passed == (radius_mm == 3.0)


def test_nobody_is_asked_without_screens_and_under_wrong_light(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore
) -> None:
    with Instrument(hardware, calibrated) as instrument:
        instrument.set_standard(BALL)
        instrument.step()
        result = checked(instrument, bench, Sphere(2.5), DEPTH_MM, PLACE)
        assert not result.passed
        assert "it reads as a ball of 2.5 mm" in result.sentence
        instrument.ask_about_checks()
        bench.faults.dimmed = {"green": 0.97}
        assert asked(instrument, bench, 2.5) == ""
    assert [check.passed for check in read_checks(calibrated.root)] == [False, False]


def test_an_unanswered_question_is_a_failed_check_when_the_instrument_stops(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore
) -> None:
    with Instrument(hardware, calibrated) as instrument:
        instrument.ask_about_checks()
        instrument.set_standard(BALL)
        instrument.step()
        assert asked(instrument, bench, 2.5)
        bench.clock.sleep(3600.0)
        for _ in range(5):
            instrument.step()
        assert not read_checks(calibrated.root)
    assert [check.passed for check in read_checks(calibrated.root)] == [False]
