"""The check standard by the whole instrument: pressed, judged, kept, and what a failed check makes doubtful."""

from datetime import timedelta

import pytest

from device.bundles.bundle import FileWriter
from device.bundles.check import CheckStandard, StandardKind
from device.bundles.scan import ScanBundle, ScanRecord
from device.instrument.events import Checked, Failed, ScanFinished
from device.instrument.instrument import Instrument
from device.store.checks import read_checks
from device.store.store import BundleStore
from hal.hardware import Hardware
from hal.interfaces import ButtonPress
from hal.simulator.bench import SimulatedScene
from hal.simulator.operator import specimen
from hal.simulator.scene import Press
from hal.simulator.surfaces import Block, Sinusoid, Sphere, Step, Surface

STANDARDS: dict[StandardKind, tuple[CheckStandard, Surface, float]] = {
    "ball": (CheckStandard(name="ball 3", kind="ball", value_um=3000.0, tolerance_um=2.0), Sphere(3.0), 0.5),
    "step": (
        CheckStandard(name="step 100", kind="step", value_um=100.0, tolerance_um=0.5),
        Step(Block(4.5, 3.5), 0.1, 0.15),
        0.5,
    ),
    "roughness": (
        CheckStandard(name="Ra 3", kind="roughness", value_um=3.0, tolerance_um=0.1),
        Sinusoid(Block(8.0, 6.0), 0.5, 0.0075),
        0.45,
    ),
}


def pressed(
    instrument: Instrument, bench: SimulatedScene, surface: Surface, depth_mm: float, place: tuple[float, float]
) -> list[Checked | ScanFinished | Failed]:
    """What becomes of a push on an object, which is then lifted."""
    for _ in range(24):
        instrument.step()
    instrument.take_events()
    bench.place(Press(surface, place, 0.0, depth_mm))
    bench.schedule_button(ButtonPress(bench.clock.monotonic_ns() + 100_000_000, 0.05))
    for _ in range(12):
        instrument.step()
    bench.place(None)
    found: list[Checked | ScanFinished | Failed] = []
    for _ in range(600):
        instrument.step()
        found += [event for event in instrument.take_events() if isinstance(event, Checked | ScanFinished | Failed)]
        if any(isinstance(event, ScanFinished | Failed) for event in found):
            return found
    raise AssertionError("nothing came of the push")


def checked(
    instrument: Instrument, bench: SimulatedScene, surface: Surface, depth_mm: float, place: tuple[float, float]
) -> Checked:
    instrument.begin_check()
    instrument.step()
    assert instrument.state.check.is_next
    found = pressed(instrument, bench, surface, depth_mm, place)
    assert not instrument.state.check.is_next
    return next(event for event in found if isinstance(event, Checked))


@pytest.mark.parametrize("kind", STANDARDS)
def test_a_right_standard_passes_at_any_place_and_a_wrong_one_fails(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore, kind: StandardKind
) -> None:
    standard, surface, depth_mm = STANDARDS[kind]
    with Instrument(hardware, calibrated) as instrument:
        instrument.set_standard(standard)
        instrument.step()
        assert instrument.state.check.is_due
        for place in ((0.0, 0.0), (0.6, -0.4), (-0.5, 0.3)):
            result = checked(instrument, bench, surface, depth_mm, place)
            assert result.passed, result.sentence
        assert not instrument.state.check.is_due
        assert len(instrument.state.check.checks) == 3
        instrument.set_standard(
            CheckStandard(
                name="other",
                kind=kind,
                value_um=(1.45 if kind == "roughness" else 1.3) * standard.value_um,
                tolerance_um=standard.tolerance_um,
            )
        )
        wrong = checked(instrument, bench, surface, depth_mm, (0.0, 0.0))
        assert not wrong.passed
        assert "FAILED" in wrong.sentence
    for check in read_checks(calibrated.root):
        assert check.passed == (check.name == standard.name)


def test_a_drifted_instrument_fails_and_makes_scans_since_the_last_good_check_doubtful(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore
) -> None:
    standard, surface, depth_mm = STANDARDS["ball"]
    coin = (Sphere(4.0), 0.5, (0.0, 0.0))
    with Instrument(hardware, calibrated) as instrument:
        instrument.set_standard(standard)
        instrument.step()
        pressed(instrument, bench, *coin)
        assert checked(instrument, bench, surface, depth_mm, (0.0, 0.0)).passed
        pressed(instrument, bench, *coin)
        assert [entry.doubt for entry in instrument.history().scans] == ["", "", ""]
        assert not checked(instrument, bench, Sphere(2.7), depth_mm, (0.0, 0.0)).passed
        (after,) = [event for event in pressed(instrument, bench, *coin) if isinstance(event, ScanFinished)]
        assert after.verdict.level == "doubtful"
        assert "check of ball 3 FAILED" in after.verdict.reason
        doubted = [bool(entry.doubt) for entry in instrument.history().scans]
        assert doubted == [True, True, True, False, False]
        assert checked(instrument, bench, surface, depth_mm, (0.0, 0.0)).passed
        pressed(instrument, bench, *coin)
        assert [bool(entry.doubt) for entry in instrument.history().scans][:2] == [False, False]
    checks = [scan.record.check for scan in calibrated.scans().bundles]
    assert checks[0] is None
    assert all(check is not None for check in checks[1:])


def refusal(
    instrument: Instrument, bench: SimulatedScene, standard: CheckStandard, surface: Surface, depth_mm: float
) -> str:
    """Why a press of something else is no check of a standard."""
    instrument.set_standard(standard)
    instrument.step()
    if not instrument.state.check.is_next:
        instrument.begin_check()
        instrument.step()
    found = pressed(instrument, bench, surface, depth_mm, (0.3, -0.2))
    assert instrument.state.check.is_next, "the check is still to be made"
    return next(event.sentence for event in found if isinstance(event, Failed))


@pytest.mark.parametrize(
    ("kind", "other", "words"),
    [
        ("ball", Sphere(1.5), "a ball of radius 1."),
        ("ball", Sphere(6.0), "a ball of radius 6."),
        ("step", Step(Block(4.5, 3.5), 0.04, 0.15), "a step of 3"),
        ("step", Step(Block(4.5, 3.5), 0.3, 0.15), "a step of 17"),
        ("roughness", Sinusoid(Block(8.0, 6.0), 0.5, 0.003), "a roughness Ra of 1."),
    ],
)
def test_another_specimen_of_the_same_kind_is_named_and_is_no_failure(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore, kind: StandardKind, other: Surface, words: str
) -> None:
    standard, _, depth_mm = STANDARDS[kind]
    expected = {"ball": "3 mm", "step": "100 µm", "roughness": "3 µm"}[kind]
    with Instrument(hardware, calibrated) as instrument:
        sentence = refusal(instrument, bench, standard, other, depth_mm)
        assert sentence.startswith(f"no standard seen: {words}")
        assert f"was seen, {expected} expected: press {standard.name}" in sentence
    assert read_checks(calibrated.root) == ()


def test_a_press_that_does_not_show_the_standard_is_refused_and_is_no_failure(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore
) -> None:
    above, flat = (Sphere(3.0), -0.5), (Block(8.0, 6.0), 0.3)
    coin = (specimen("coin").surface, specimen("coin").indentation_mm)
    with Instrument(hardware, calibrated) as instrument:
        for kind, (standard, _, _) in STANDARDS.items():
            others: list[tuple[Surface, float]] = [
                (surface, depth) for other, (_, surface, depth) in STANDARDS.items() if other != kind
            ]
            # A coin's engraving resembles a roughness specimen, and cannot be distinguished from it.
            for surface, depth_mm in (above, flat, *others, *([] if kind == "roughness" else [coin])):
                sentence = refusal(instrument, bench, standard, surface, depth_mm)
                assert sentence.startswith("no standard seen: "), (kind, surface, sentence)
        bench.faults.dimmed = {"green": 0.5}
        assert "light green" in refusal(instrument, bench, STANDARDS["ball"][0], *STANDARDS["ball"][1:])
    assert read_checks(calibrated.root) == ()
    assert not calibrated.scans().bundles


@pytest.mark.parametrize("dimmed", [{"green": 0.8}, {"red": 1.4}, {"blue": 1.2}])
def test_a_standard_that_drifted_light_hides_is_a_failed_check(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore, dimmed: dict[str, float]
) -> None:
    standard, surface, depth_mm = STANDARDS["ball"]
    (name,) = dimmed
    with Instrument(hardware, calibrated) as instrument:
        bench.faults.dimmed = dimmed
        instrument.set_standard(standard)
        result = checked(instrument, bench, surface, depth_mm, (0.3, -0.2))
        assert not result.passed
        assert f"it does not show under this light (light {name} is" in result.sentence
        for other in (above := Sphere(3.0), specimen("coin").surface):
            depth = -0.5 if other is above else 0.5
            assert refusal(instrument, bench, standard, other, depth).startswith("no standard seen: ")
    (check,) = read_checks(calibrated.root)
    assert check.measured_um is None
    (scan,) = calibrated.scans().bundles
    assert scan.record.check == check


@pytest.mark.parametrize("dimmed", [{"green": 0.9}, {"red": 0.8}])
def test_a_ball_that_shows_under_drifted_light_is_measured(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore, dimmed: dict[str, float]
) -> None:
    standard, surface, depth_mm = STANDARDS["ball"]
    with Instrument(hardware, calibrated) as instrument:
        bench.faults.dimmed = dimmed
        instrument.set_standard(standard)
        checked(instrument, bench, surface, depth_mm, (0.3, -0.2))
    (check,) = read_checks(calibrated.root)
    assert check.measured_um == pytest.approx(3000.0, rel=0.08)


def test_another_standard_clears_no_failure(bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore) -> None:
    ball, step = STANDARDS["ball"], STANDARDS["step"]
    with Instrument(hardware, calibrated) as instrument:
        instrument.set_standard(ball[0])
        assert not checked(instrument, bench, Sphere(2.4), 0.5, (0.0, 0.0)).passed
        instrument.set_standard(step[0])
        assert checked(instrument, bench, *step[1:], (0.0, 0.0)).passed
        assert [one.name for one in instrument.state.check.failed_others] == ["ball 3"]
        found = pressed(instrument, bench, Sphere(4.0), 0.5, (0.0, 0.0))
        (after,) = [event for event in found if isinstance(event, ScanFinished)]
        assert "check of ball 3 FAILED" in after.verdict.reason
        assert [bool(entry.doubt) for entry in instrument.history().scans] == [True, True, True]
        instrument.set_standard(ball[0])
        assert checked(instrument, bench, *ball[1:], (0.0, 0.0)).passed
        pressed(instrument, bench, Sphere(4.0), 0.5, (0.0, 0.0))
        assert [bool(entry.doubt) for entry in instrument.history().scans][:2] == [False, False]


class PowerCut(BaseException):
    """The supply ends."""


class CutStore(BundleStore):
    """A store whose instrument loses its supply beside the publishing of a scan.

    Parameters
    ----------
    is_before : before the scan is published, otherwise after it
    """

    is_before = False

    def publish_scan(self, record: ScanRecord, write: FileWriter) -> ScanBundle:
        if not self.is_before:
            super().publish_scan(record, write)
        raise PowerCut


@pytest.mark.parametrize("is_before", [True, False])
def test_a_power_cut_beside_publishing_keeps_a_failed_check(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore, is_before: bool
) -> None:
    store = CutStore(calibrated.root, hardware.clock, boot_id="b0075e1f")
    store.is_before = is_before
    instrument = Instrument(hardware, store)
    instrument.__enter__()
    instrument.set_standard(STANDARDS["ball"][0])
    with pytest.raises(PowerCut):
        checked(instrument, bench, Sphere(2.4), 0.5, (0.0, 0.0))
    hardware.__exit__(None, None, None)
    assert [check.passed for check in read_checks(store.root)] == [False]


def test_the_check_is_due_again_the_next_day(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore
) -> None:
    standard, surface, depth_mm = STANDARDS["ball"]
    with Instrument(hardware, calibrated) as instrument:
        instrument.set_standard(standard)
        instrument.step()
        checked(instrument, bench, surface, depth_mm, (0.0, 0.0))
        assert not instrument.state.check.is_due
        bench.clock.sleep(timedelta(days=1).total_seconds())
        for _ in range(3):
            instrument.step()
        assert instrument.state.check.is_due
