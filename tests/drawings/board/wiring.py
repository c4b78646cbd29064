"""The wires of one board, from board/wiring/wiring.toml and the board's profile."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hal.board_profile import BoardProfile, ButtonConfig, LightDriverConfig, load_board_profile
from hal.profile_tables import profile_names

WIRING_FILE = Path(__file__).parents[3] / "board" / "wiring" / "wiring.toml"
FIVE_VOLT = {"LED+", "+5V"}
"""Terminals on the 5 V rail; every other supply is 3.3 V."""


@dataclass(frozen=True, slots=True)
class Wire:
    """One wire from a pin of the header to a part's terminal."""

    pin: int
    pin_name: str
    part: str
    terminal: str
    kind: str


@dataclass(frozen=True, slots=True)
class Led:
    """The LEDs of one light: the channels that sink them, and the current (mA) in each."""

    light: str
    colour: str
    channels: tuple[int, ...]
    current_ma: float


@dataclass(frozen=True, slots=True)
class Wiring:
    """Everything that is wired on one board.

    channel_name : prefix of the light driver's output names
    parts : name and connections of its own pins, in the order of the drawing
    """

    board: str
    title: str
    header: tuple[str, ...]
    wires: tuple[Wire, ...]
    leds: tuple[Led, ...]
    channel_name: str
    parts: tuple[tuple[str, tuple[str, ...]], ...]


def wired_boards() -> list[str]:
    """Names of the profiles with wiring: not the simulated ones, nor sensors on USB."""
    return [name for name in profile_names() if load_board_profile(name).driver == "picamera2"]


def drawn_boards() -> list[str]:
    """Names of the boards that have pages: of boards that are wired alike the first one."""
    first: dict[tuple[object, ...], str] = {}
    for name in wired_boards():
        facts = wiring(name)
        first.setdefault((facts.wires, facts.leds, facts.parts), name)
    return list(first.values())


def wiring(board: str, facts: dict[str, Any] | None = None) -> Wiring:
    """The wiring of the board of that name.

    Raises
    ------
    ValueError
        Profile and wiring contradict each other, or a pin of the header gets two plugs.
    """
    facts = facts or tomllib.loads(WIRING_FILE.read_text(encoding="utf-8"))
    return of_profile(load_board_profile(board), facts)


def of_profile(profile: BoardProfile, facts: dict[str, Any]) -> Wiring:
    """The wiring of that profile; see `wiring`."""
    if profile.light_driver is None or profile.button is None:
        raise ValueError(f"{profile.name}: has no light driver or no button, so there is nothing to wire")
    wires = (*_light_driver(profile.light_driver, facts), *_button(profile.button, facts), *_others(profile, facts))
    plugs: dict[int, str] = {}
    for wire in wires:
        plug = f"{wire.part} {wire.terminal}"
        if (other := plugs.setdefault(wire.pin, plug)) != plug:
            raise ValueError(f"{profile.name}: pin {wire.pin} of the header gets two plugs: {other} and {plug}")
    leds = tuple(Led(light.name, light.colour, light.channels, light.current_ma) for light in profile.lights)
    if profile.indicator and profile.indicator.channel is not None:
        leds += (Led("indicator", "any", (profile.indicator.channel,), profile.indicator.current_ma),)
    chip = _chip(facts, profile.light_driver.chip, profile.light_driver.address)
    ties = tuple(tie.format(reference_ohm=f"{profile.light_driver.reference_ohm:g}") for tie in chip["ties"])
    parts = [(profile.light_driver.chip, ties)]
    parts.append(("button", ("closes to ground; the pull-up is the Pi's own",)))
    if profile.indicator and profile.indicator.line is not None:
        parts.append(("indicator", (f"LED and {facts['indicator']['series_ohm']} ohm in series, to ground",)))
    if profile.name in facts["panel"]["boards"]:
        parts.append(("panel", ("5 V of a DSI panel, its ribbon on a Pi 5 to CAM/DISP 0; may stay open",)))
    if profile.name in facts["supply"]["boards"]:
        parts.append(("supply", ("feeds the board (bill of materials); leave open when the USB port does",)))
    parts.append(("power-fail", ("open drain of the supply, else by a diode (bill of materials); may stay open",)))
    parts.append(("power-off", ("OFF of a latching switch (bill of materials); may stay open",)))
    title = (
        f"{profile.name}: {profile.sensor.model}, {profile.light_driver.chip} at {profile.light_driver.address:#04x}"
    )
    return Wiring(profile.name, title, tuple(facts["header"]), wires, leds, chip["terminals"]["channel"], tuple(parts))


def _light_driver(driver: LightDriverConfig, facts: dict[str, Any]) -> Iterator[Wire]:
    place = facts["light_driver"]
    terminals = _chip(facts, driver.chip, driver.address)["terminals"]
    lines = facts["bus"][str(driver.bus)]
    yield _wire(facts, place["supply"], driver.chip, terminals["supply"], "supply")
    yield _wire(facts, place["ground"], driver.chip, terminals["ground"], "ground")
    for signal in ("sda", "scl"):
        yield _wire(facts, facts["header"].index(lines[signal]) + 1, driver.chip, terminals[signal], signal)
    if driver.enable_line is not None:
        yield _line(facts, driver.enable_line, driver.chip, terminals["enable"])
    yield _wire(facts, place["led_supply"], driver.chip, "LED+", "supply")


def _button(button: ButtonConfig, facts: dict[str, Any]) -> Iterator[Wire]:
    yield _line(facts, button.line, "button", "contact")
    yield _wire(facts, facts["button"]["ground"], "button", "ground", "ground")


def _others(profile: BoardProfile, facts: dict[str, Any]) -> Iterator[Wire]:
    for part in ("panel", "supply"):
        if profile.name in facts[part]["boards"]:
            yield _wire(facts, facts[part]["supply"], part, "+5V", "supply")
            yield _wire(facts, facts[part]["ground"], part, "ground", "ground")
    if profile.indicator and profile.indicator.line is not None:
        yield _line(facts, profile.indicator.line, "indicator", "anode")
        yield _wire(facts, facts["indicator"]["ground"], "indicator", "ground", "ground")
    yield _line(facts, facts["power_fail"]["line"], "power-fail", "signal")
    yield _wire(facts, facts["power_fail"]["ground"], "power-fail", "ground", "ground")
    yield _line(facts, facts["power_off"]["line"], "power-off", "OFF")
    yield _wire(facts, facts["power_off"]["ground"], "power-off", "ground", "ground")


def _line(facts: dict[str, Any], line: int, part: str, terminal: str) -> Wire:
    return _wire(facts, facts["header"].index(f"GPIO{line}") + 1, part, terminal, "line")


def _wire(facts: dict[str, Any], pin: int, part: str, terminal: str, kind: str) -> Wire:
    name = facts["header"][pin - 1]
    expected = {"ground": "GND", "supply": "5V" if terminal in FIVE_VOLT else "3V3"}.get(kind, name)
    if name != expected:
        raise ValueError(f"{WIRING_FILE.name}: {part} {terminal} is on pin {pin}, which is {name}")
    return Wire(pin, name, part, terminal, kind)


def _chip(facts: dict[str, Any], name: str, address: int) -> dict[str, Any]:
    for chip in facts["chip"]:
        if chip["name"] == name:
            if chip["address"] != address:
                raise ValueError(
                    f"{WIRING_FILE.name}: {name} is tied to {chip['address']:#04x}, the profile says {address:#04x}"
                )
            return chip  # type: ignore[no-any-return]
    raise ValueError(f"{WIRING_FILE.name}: says nothing of {name}")
