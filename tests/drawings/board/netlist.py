"""Every connection of one board as a net list: header, chips with all their pins, resistors, capacitors, LEDs, button.

It follows from the wiring and from what is said of the chips' own pins; what cannot be understood there is refused.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, Literal

from tests.drawings.board.wiring import Led, Wiring

Role = Literal["source", "ground", "supply", "output", "input", "open drain", "pull", "sink", "passive"]
CHANNELS: Final = 16
SUPPLIES: Final = {"VDD", "VCC"}
GROUNDS: Final = {"VSS", "GND"}
NAMES: Final = {"3V3": "3V3", "5V": "5V", "GND": "GND"}
OUTPUTS: Final = {"OE", "RESET", "OFF", "anode"}
"""Terminals that a line of the header drives; it listens to all other lines."""

_VALUE: Final = re.compile(r"(\w+): ([\d.]+) (ohm|kohm|nF) to (\w+)\b")
_DIRECT: Final = re.compile(r"([A-Z]\w*)((?:, [A-Z]\w*)*): to (\w+)\b")
_PAIR: Final = re.compile(r"\b(AD?\d) (VSS|VDD|GND|VCC)\b")
_UNIT: Final = {"ohm": 1.0, "kohm": 1e3, "nF": 1e-9}


@dataclass(frozen=True, slots=True, order=True)
class Pin:
    """One pin on a net.

    role : what the pin does to the net
    value : of a resistor, ohm, or of a capacitor, farad; None for other parts
    """

    part: str
    terminal: str
    role: Role
    value: float | None = None


def netlist(wiring: Wiring) -> dict[str, tuple[Pin, ...]]:
    """Pins of every net by its name, in order.

    Raises
    ------
    ValueError
        A chip's pins are described in words that this cannot read.
    """
    nets: dict[str, set[Pin]] = defaultdict(set)
    for net, pin in _pins(wiring):
        nets[net].add(pin)
    return {net: tuple(sorted(pins)) for net, pins in sorted(nets.items())}


def netlist_page(wiring: Wiring) -> str:
    """The file `board/wiring/<board>.nets.csv`."""
    lines = ["net,part,terminal,role,value"]
    for net, pins in netlist(wiring).items():
        for pin in pins:
            value = "" if pin.value is None else f"{pin.value:g} {'ohm' if pin.value >= 1.0 else 'F'}"
            lines.append(f"{net},{pin.part},{pin.terminal},{pin.role},{value}")
    return "\n".join(lines) + "\n"


def _pins(wiring: Wiring) -> Iterator[tuple[str, Pin]]:
    for wire in wiring.wires:
        net = wire.pin_name
        if wire.kind in {"supply", "ground"}:
            yield net, Pin("header", str(wire.pin), "source" if wire.kind == "supply" else "ground")
            role: Role = "ground" if wire.kind == "ground" else "source" if wire.part == "supply" else "supply"
            yield net, Pin(wire.part, wire.terminal, role)
        elif wire.kind in {"sda", "scl"}:
            yield net, Pin("header", str(wire.pin), "open drain")
            yield net, Pin(wire.part, wire.terminal, "open drain")
        else:
            yield from _line(wire.pin, net, wire.part, wire.terminal)
    for net in ("GPIO2", "GPIO3"):
        yield from _between(f"the Pi's own pull-up of {net}", 1.8e3, net, "3V3")
    for part, ties in wiring.parts:
        for tie in ties:
            yield from _tied(wiring, part, tie)
    yield from _leds(wiring)


def _line(pin: int, net: str, part: str, terminal: str) -> Iterator[tuple[str, Pin]]:
    drives = terminal in OUTPUTS
    yield net, Pin("header", str(pin), "output" if drives else "input")
    yield net, Pin(part, terminal, "input" if drives else "open drain")
    if not drives:  # button and power-fail line
        yield from _between(f"the Pi's own pull-up of {net}", 50e3, net, "3V3")


def _tied(wiring: Wiring, part: str, tie: str) -> Iterator[tuple[str, Pin]]:
    """Connections of a chip's own pins; what is said of other parts is words."""
    rails = {wire.terminal: wire.pin_name for wire in wiring.wires if wire.part == part}
    supply = next((rails[name] for name in rails if name in SUPPLIES), None)
    if supply is None or not any(wire.kind == "sda" for wire in wiring.wires if wire.part == part):
        return

    def net_of(name: str) -> str:
        return "GND" if name in GROUNDS else supply if name in SUPPLIES else rails.get(name, f"{part} {name}")

    if found := _VALUE.match(tie):
        pin, value, far = found[1], float(found[2]) * _UNIT[found[3]], net_of(found[4])
        if pin not in rails and pin not in SUPPLIES:
            yield net_of(pin), Pin(part, pin, "passive")
        kind = "capacitor" if found[3] == "nF" else "resistor"
        yield from _between(f"{kind} at {part} {pin}", value, net_of(pin), far)
    elif found := _DIRECT.match(tie):
        for name in (found[1], *found[2].strip(", ").split(", ")):
            if name:
                yield net_of(found[3]), Pin(part, name, "input")
    elif pairs := _PAIR.findall(tie):
        for name, rail in pairs:
            yield net_of(rail), Pin(part, name, "input")
    else:
        raise ValueError(f"{part}: cannot read {tie!r}: write 'PIN: to NET' or 'PIN: 10 kohm to NET'")


def _leds(wiring: Wiring) -> Iterator[tuple[str, Pin]]:
    chip = wiring.parts[0][0]
    used: dict[int, Led] = {channel: led for led in wiring.leds for channel in led.channels}
    for channel in range(CHANNELS):
        name = f"{wiring.channel_name}{channel}"
        yield f"{chip} {name}", Pin(chip, name, "sink")
        if channel in used:
            led = f"{used[channel].light} LED at {name}"
            yield f"{chip} {name}", Pin(led, "cathode", "passive")
            yield "5V", Pin(led, "anode", "passive")
    yield from _between("capacitor at LED+", 100e-6, "5V", "GND")


def _between(part: str, value: float, net: str, far: str) -> Iterator[tuple[str, Pin]]:
    """A part with two ends; a resistor to a rail pulls."""
    pulls = value >= 1.0 and far in NAMES.values()
    yield net, Pin(part, "1", "pull" if pulls else "passive", value)
    yield far, Pin(part, "2", "passive", value)
