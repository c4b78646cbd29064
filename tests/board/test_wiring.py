"""Drawings, tables and pin maps are what the profiles and the wiring say; contradictions are refused."""

import tomllib
from pathlib import Path
from xml.etree import ElementTree

import msgspec
import pytest

from hal.board_profile import load_board_profile
from tests.drawings.board import drawings, wiring

ROOT = Path(__file__).parents[2]
WIRED = ("pi4-imx477", "pi4-imx477-binned", "pi5-imx296", "zero2w-imx708")


@pytest.fixture
def facts() -> dict[str, object]:
    return tomllib.loads((ROOT / "board/wiring/wiring.toml").read_text(encoding="utf-8"))


def test_what_is_drawn_is_what_is_there() -> None:
    """`make board` would change nothing; tables of figures may differ in the last digit on another processor."""
    for place, text in drawings.pages().items():
        assert (ROOT / "board" / place).read_text(encoding="utf-8") == text, f"run `make board`: board/{place} is old"


def test_every_wired_board_has_its_pages() -> None:
    assert tuple(wiring.wired_boards()) == WIRED
    shown = {path.stem for path in (ROOT / "board/wiring").iterdir() if path.suffix in {".svg", ".md"}}
    assert shown == set(WIRED) - {"pi4-imx477-binned"}, "which is wired as pi4-imx477"


@pytest.mark.parametrize("board", wiring.drawn_boards())
def test_a_drawing_shows_every_wire_of_its_profile(board: str) -> None:
    profile = load_board_profile(board)
    drawn = ElementTree.parse(ROOT / f"board/wiring/{board}.svg")  # noqa: S314
    told = {element.text for element in drawn.iter("{http://www.w3.org/2000/svg}title")}
    wired = wiring.wiring(board)
    assert told == {f"pin {wire.pin} {wire.pin_name} to {wire.part} {wire.terminal}" for wire in wired.wires}
    assert profile.button is not None
    assert f"pin 11 GPIO{profile.button.line} to button contact" in told
    channels = [channel for led in wired.leds for channel in led.channels]
    assert set(channels) >= {channel for light in profile.lights for channel in light.channels}
    if profile.indicator and profile.indicator.line is not None:
        assert f"pin 13 GPIO{profile.indicator.line} to indicator anode" in told


def test_the_header_is_the_raspberry_pis(facts: dict[str, list[str]]) -> None:
    header = facts["header"]
    assert len(header) == 40
    assert [pin for pin, name in enumerate(header, 1) if name == "GND"] == [6, 9, 14, 20, 25, 30, 34, 39]
    assert [pin for pin, name in enumerate(header, 1) if name in {"3V3", "5V"}] == [1, 2, 4, 17]
    lines = sorted(int(name.removeprefix("GPIO")) for name in header if name.startswith("GPIO"))
    assert lines == list(range(28))


def test_contradictions_are_refused(facts: dict[str, dict[str, int]]) -> None:
    profile = load_board_profile("pi4-imx477")
    assert profile.light_driver is not None
    elsewhere = msgspec.structs.replace(profile.light_driver, address=0x16)
    with pytest.raises(ValueError, match="PCA9955B is tied to 0x15, the profile says 0x16"):
        wiring.of_profile(msgspec.structs.replace(profile, light_driver=elsewhere), facts)
    assert profile.indicator is not None
    same = msgspec.structs.replace(profile.indicator, line=22)
    with pytest.raises(ValueError, match="pin 15 of the header gets two plugs: indicator anode and power-fail signal"):
        wiring.of_profile(msgspec.structs.replace(profile, indicator=same), facts)
    facts["button"]["ground"] = 4
    with pytest.raises(ValueError, match="button ground is on pin 4, which is 5V"):
        wiring.of_profile(profile, facts)


@pytest.mark.parametrize("board", WIRED)
def test_a_pull_keeps_the_lights_dark_until_the_program_drives_the_line(board: str) -> None:
    wired, profile = wiring.wiring(board), load_board_profile(board)
    assert profile.light_driver is not None
    terminal, pull = {"PCA9955B": ("OE", "10 kohm to VDD"), "TLC59116": ("RESET", "10 kohm to GND")}[
        profile.light_driver.chip
    ]
    (wire,) = [wire for wire in wired.wires if wire.terminal == terminal]
    assert wire.pin_name == f"GPIO{profile.light_driver.enable_line}"
    (ties,) = [ties for part, ties in wired.parts if part == profile.light_driver.chip]
    assert any(tie.startswith(f"{terminal}: {pull}") for tie in ties)


def test_the_line_that_switches_off_is_the_one_that_install_names(facts: dict[str, dict[str, int]]) -> None:
    firmware = (ROOT / "board/install/firmware.sh").read_text(encoding="utf-8")
    assert f'dtoverlay=gpio-poweroff,gpiopin={facts["power_off"]["line"]}"' in firmware
    # The pin is pulled down when a Pi starts: an OFF input that acts at high is left alone until the system has halted.
    assert facts["power_off"]["line"] >= 9
    bill = (ROOT / "board/bill-of-materials.md").read_text(encoding="utf-8")
    assert "| power latch |" in bill
    assert "| power switch |" in bill


def test_gain_is_the_cotangent_of_the_elevation() -> None:
    """The figures' own check: closed forms for a diffuse skin."""
    from tests.drawings.board.light_geometry import Geometry, all_lit_deg, gain, unevenness

    assert gain(Geometry()) == pytest.approx(3**0.5, rel=1e-3)
    assert gain(Geometry(elevation_deg=45.0)) == pytest.approx(1.0, rel=1e-3)
    assert all_lit_deg(Geometry(elevation_deg=40.0)) == pytest.approx(40.0, abs=0.5)
    assert unevenness(Geometry(distance_mm=10_000.0)) == pytest.approx(1.0, abs=0.02)
