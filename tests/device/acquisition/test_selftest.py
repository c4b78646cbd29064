"""The self-test names the faulty part, with the twin and with the real drivers."""

from collections.abc import Callable

import pytest
from emulated_board import LIGHTS_AT, EmulatedBoard, emulated_hardware

from device.acquisition.selftest import Finding, selftest
from hal.errors import LightError
from hal.hardware import Hardware
from hal.simulator.bench import SimulatedScene

PARTS = ["power", "button", "light driver", "indicator", "camera", "darkness", "light red", "light green", "light blue"]


@pytest.fixture(params=["PCA9955B", "TLC59116"])
def emulated(bench: SimulatedScene, request: pytest.FixtureRequest) -> EmulatedBoard:
    return emulated_hardware(bench, request.param)


def findings(hardware: Hardware) -> dict[str, Finding]:
    return {finding.part: finding for finding in selftest(hardware)}


def failed(hardware: Hardware) -> dict[str, str]:
    return {part: finding.sentence for part, finding in findings(hardware).items() if finding.state == "failed"}


def test_a_good_twin_and_a_good_board_pass_in_order(hardware: Hardware, emulated: EmulatedBoard) -> None:
    for good in (hardware, emulated.hardware):
        found = list(selftest(good, ask_for_push=True))
        assert [finding.part for finding in found] == [*PARTS, "button push"]
        assert {finding.state for finding in found} == {"ok"}
    assert not any(emulated.leds.currents_ma())
    assert emulated.cameras.opened == emulated.wire.opened == 0


def unplug(emulated: EmulatedBoard) -> None:
    emulated.wire.faults.unplugged.add(LIGHTS_AT)


def open_green(emulated: EmulatedBoard) -> None:
    emulated.leds.open_channels.update({4, 5})


def short_green(emulated: EmulatedBoard) -> None:
    emulated.leds.shorted_channels.update({4, 5})


def hold_button(emulated: EmulatedBoard) -> None:
    emulated.line.held_down = True


def tear_camera(emulated: EmulatedBoard) -> None:
    emulated.bench.faults.camera_missing = True


def sag(emulated: EmulatedBoard) -> None:
    emulated.firmware.throttled = "50005"


def break_gauge(emulated: EmulatedBoard) -> None:
    emulated.wire.faults.unplugged.add(0x36)


@pytest.mark.parametrize(
    ("fault", "part", "sentence"),
    [
        (unplug, "light driver", "no chip answers at 0x15 on bus 1: .*check SDA/SCL on pins 3 and 5"),
        (open_green, "light green", "not visible to the camera; the driver reports open: .* channels 4, 5"),
        (
            short_green,
            "light green",
            "not visible to the camera; the driver reports (short|no fault): .* channels 4, 5",
        ),
        (hold_button, "button", "is held down or its line is shorted"),
        (tear_camera, "camera", "imx296@1a is not there: .*ribbon cable"),
        (sag, "power", "the supply voltage is too low:"),
        (break_gauge, "power", "no chip answers at 0x36 on bus 1"),
    ],
)
def test_a_fault_is_blamed_on_its_part_and_on_no_other(
    emulated: EmulatedBoard, fault: Callable[[EmulatedBoard], None], part: str, sentence: str
) -> None:
    fault(emulated)
    found = findings(emulated.hardware)
    blamed = {name: finding.sentence for name, finding in found.items() if finding.state == "failed"}
    assert list(blamed) == [part]
    with pytest.raises(AssertionError, match=sentence):
        raise AssertionError(blamed[part])
    assert [name for name in PARTS if name in found or name == "darkness"] == PARTS
    assert not any(emulated.leds.currents_ma())


def test_one_open_led_of_two_is_a_warning_since_the_light_is_seen(emulated: EmulatedBoard) -> None:
    emulated.leds.open_channels.add(0)
    found = findings(emulated.hardware)["light red"]
    assert found.state == "warning"
    assert "but driver reports open" in found.sentence


def test_swapped_lights_are_seen_by_their_colour(emulated: EmulatedBoard) -> None:
    straight = emulated.bench.drive
    swapped = {"red": "green", "green": "red"}
    emulated.bench.drive = lambda currents: straight(  # type: ignore[method-assign]
        {swapped.get(name, name): current for name, current in currents.items()}
    )
    blamed = failed(emulated.hardware)
    assert list(blamed) == ["light red", "light green"]
    assert "should be R but is G: two lights are swapped" in blamed["light red"]


def test_what_depends_on_a_broken_part_is_skipped_and_says_why(emulated: EmulatedBoard) -> None:
    unplug(emulated)
    found = findings(emulated.hardware)
    assert found["camera"].state == "ok"
    for part in ("indicator", "light red", "light green", "light blue"):
        assert found[part] == Finding(part, "skipped", "not tested because the light driver failed")


def test_light_from_outside_is_a_warning(hardware: Hardware, bench: SimulatedScene) -> None:
    straight = bench.drive
    bench.drive = lambda currents: straight({"red": 6.0} | dict(currents))  # type: ignore[method-assign]
    assert findings(hardware)["darkness"].state == "warning"


def test_lights_end_dark_when_the_walk_is_broken_off(emulated: EmulatedBoard) -> None:
    walk = selftest(emulated.hardware)
    for finding in walk:
        if finding.part == "light red":
            break
    walk.close()  # type: ignore[attr-defined]
    assert not any(emulated.leds.currents_ma())
    with pytest.raises(LightError):
        emulated.hardware.lights.granted_ma({"moon": 1.0})
