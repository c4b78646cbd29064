"""Every board's net list keeps the electrical rules, and each rule finds what it is for."""

import csv
import io
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import pytest

from hal.board_profile import BoardProfile, load_board_profile
from tests.drawings.board.electrical_rules import complaints
from tests.drawings.board.netlist import netlist
from tests.drawings.board.wiring import Wiring, drawn_boards, of_profile, wired_boards, wiring

ROOT = Path(__file__).parents[2]


def facts() -> dict[str, Any]:
    return tomllib.loads((ROOT / "board/wiring/wiring.toml").read_text(encoding="utf-8"))


@pytest.mark.parametrize("board", wired_boards())
def test_a_board_keeps_every_rule(board: str) -> None:
    assert complaints(load_board_profile(board), wiring(board)) == []


@pytest.mark.parametrize("board", drawn_boards())
def test_every_wire_led_and_chip_is_on_a_net(board: str) -> None:
    wired = wiring(board)
    nets = netlist(wired)
    where = {(pin.part, pin.terminal): net for net, pins in nets.items() for pin in pins}
    for wire in wired.wires:
        assert where[wire.part, wire.terminal] == where["header", str(wire.pin)] == wire.pin_name
    lit = [pin for pins in nets.values() for pin in pins if pin.terminal == "cathode"]
    assert len(lit) == sum(len(led.channels) for led in wired.leds)
    text = (ROOT / f"board/wiring/{board}.nets.csv").read_text(encoding="utf-8")
    assert {row["net"] for row in csv.DictReader(io.StringIO(text))} == set(nets)


def _tie(name: str, old: str, new: str) -> Callable[[dict[str, Any]], None]:
    def change(found: dict[str, Any]) -> None:
        chip = next(one for one in found["chip"] if one["name"] == name)
        assert any(old in tie for tie in chip["ties"])
        chip["ties"] = [new if old in tie else tie for tie in chip["ties"] if new or old not in tie]

    return change


def _place(part: str, key: str, value: int) -> Callable[[dict[str, Any]], None]:
    def change(found: dict[str, Any]) -> None:
        found[part][key] = value

    return change


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (_tie("PCA9955B", "RESET", ""), "PCA9955B RESET: floats"),
        (_tie("PCA9955B", "REXT", ""), "PCA9955B REXT: floats"),
        (_tie("PCA9955B", "AD2", "AD2 VSS, AD0 VSS: address 0x15"), "PCA9955B AD1: floats"),
        (_tie("PCA9955B", "OE", "OE: 100 ohm to VDD"), "GPIO6: the pull takes 33.0 mA"),
        (_tie("PCA9955B", "OE", "OE: to SDA"), "PCA9955B OE: stands on 2 nets"),
        (_tie("PCA9955B", "REXT", "REXT: 1000 ohm to VSS"), "REXT: {1000.0} ohm are wired, the profile says 2400"),
        (_place("light_driver", "led_supply", 17), "PCA9955B LED+ is on pin 17, which is 3V3"),
        (_place("light_driver", "supply", 4), "PCA9955B VDD is on pin 4, which is 5V"),
        (_place("power_off", "line", 17), "pin 11 of the header gets two plugs: button contact and power-off OFF"),
        (_place("panel", "supply", 2), "pin 2 of the header gets two plugs: PCA9955B LED+ and panel +5V"),
        (_place("button", "ground", 9), "pin 9 of the header gets two plugs: PCA9955B VSS and button ground"),
        (_place("panel", "supply", 6), "panel +5V is on pin 6, which is GND"),
    ],
)
def test_a_mistake_is_found(change: Callable[[dict[str, Any]], None], complaint: str) -> None:
    found, profile = facts(), load_board_profile("pi5-imx296")
    change(found)
    assert any(complaint in sentence for sentence in _judged(profile, found)), _judged(profile, found)


def test_a_rail_that_nothing_feeds_is_found() -> None:
    wired = wiring("pi5-imx296")
    dead = replace(wired, wires=tuple(wire for wire in wired.wires if wire.pin_name != "5V"))
    assert "5V: nothing feeds it" in complaints(load_board_profile("pi5-imx296"), dead)


def test_a_reference_resistor_that_lets_too_much_through_is_found() -> None:
    profile = load_board_profile("pi5-imx296")
    assert profile.light_driver is not None
    low = msgspec.structs.replace(profile.light_driver, reference_ohm=1000.0)
    said = _judged(msgspec.structs.replace(profile, light_driver=low), facts())
    assert any("lets 57.4 mA through, LEDs carry 25 mA" in sentence for sentence in said)
    assert any("W into heat" in sentence for sentence in said)


def test_words_that_say_no_connection_are_refused() -> None:
    found = facts()
    _tie("PCA9955B", "RESET", "RESET high")(found)
    assert any("cannot read 'RESET high'" in sentence for sentence in _judged(load_board_profile("pi5-imx296"), found))


def _judged(profile: BoardProfile, found: dict[str, Any]) -> list[str]:
    try:
        wired: Wiring = of_profile(profile, found)
        return complaints(profile, wired)
    except ValueError as error:
        return [str(error)]
