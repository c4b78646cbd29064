"""What is wrong with a net list, by rules that every board keeps: one driver a net, rails, levels, pulls, currents."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from typing import Final

from hal.board_profile import BoardProfile, LightDriverConfig
from tests.drawings.board.netlist import Pin, netlist
from tests.drawings.board.wiring import FIVE_VOLT, Wiring

VOLTS: Final = {"3V3": 3.3, "5V": 5.1, "GND": 0.0}
CHIP_VOLTS: Final = {"PCA9955B": (3.0, 5.5), "TLC59116": (3.0, 5.5)}
"""Supply range of each chip, by its maker."""

CHIP_PINS: Final = {
    "PCA9955B": {"VDD", "VSS", "SDA", "SCL", "OE", "RESET", "REXT", "AD0", "AD1", "AD2"},
    "TLC59116": {"VCC", "GND", "SDA", "SCL", "RESET", "REXT", "A0", "A1", "A2", "A3"},
}
"""Every pin that must not float, beside the outputs."""

FULL_SCALE_VOLT_PER_OHM: Final = {"PCA9955B": 57.375, "TLC59116": 18.75}
"""Largest current, mA, times the reference resistor, kohm."""

FORWARD_VOLTS: Final = {"R": (1.8, 2.4), "G": (2.8, 3.4), "B": (2.8, 3.4), "any": (1.8, 3.4)}
WEAKEST_SUPPLY_V: Final = 4.75
OUTPUT_DROP_V: Final = 0.8
MAX_HEAT_W: Final = 0.6
GPIO_MA: Final = 8.0
LED_SUPPLY_MA: Final = 500.0


def largest_ma(driver: LightDriverConfig) -> float:
    """Current that the reference resistor lets through each channel, at most."""
    return FULL_SCALE_VOLT_PER_OHM[driver.chip] / driver.reference_ohm * 1e3


def complaints(profile: BoardProfile, wiring: Wiring) -> list[str]:
    """Sentences on every rule that the board breaks; empty when it keeps them all."""
    nets = netlist(wiring)
    found = [complaint for net, pins in nets.items() for complaint in _of_net(net, pins)]
    return [*found, *_misplaced(wiring, nets), *_currents(profile, wiring, nets)]


def _of_net(net: str, pins: tuple[Pin, ...]) -> Iterator[str]:
    roles = [pin.role for pin in pins]
    if net in VOLTS:
        if any(role in {"output", "open drain", "sink"} for role in roles):
            yield f"{net}: a rail is driven"
        for pin in pins:
            low, high = CHIP_VOLTS.get(pin.part, (0.0, 100.0))
            if pin.role == "supply" and pin.terminal not in FIVE_VOLT and not low <= VOLTS[net] <= high:
                yield f"{net}: {pin.part} takes {low:g} to {high:g} V"
        if net != "GND" and "source" not in roles:
            yield f"{net}: nothing feeds it"
        return
    if len(pins) < 2 and roles != ["sink"]:
        yield f"{net}: has one end only"
    drivers = roles.count("output") + ("open drain" in roles) + ("sink" in roles)
    if drivers > 1:
        yield f"{net}: is driven twice"
    if "open drain" in roles and "pull" not in roles:
        yield f"{net}: only ever pulled low, and no resistor pulls it up"
    if "source" in roles or "supply" in roles:
        yield f"{net}: a supply hangs on a line"


def _misplaced(wiring: Wiring, nets: dict[str, tuple[Pin, ...]]) -> Iterator[str]:
    there = Counter((pin.part, pin.terminal) for pins in nets.values() for pin in pins)
    for (part, name), number in there.items():
        if number > 1:
            yield f"{part} {name}: stands on {number} nets"
    for part in {part for part, _ in wiring.parts} & set(CHIP_PINS):
        for name in sorted(CHIP_PINS[part]):
            if (part, name) not in there:
                yield f"{part} {name}: floats"


def _currents(profile: BoardProfile, wiring: Wiring, nets: dict[str, tuple[Pin, ...]]) -> Iterator[str]:
    driver = profile.light_driver
    assert driver is not None
    reference = f"resistor at {driver.chip} REXT"
    ohms = {pin.value for pins in nets.values() for pin in pins if pin.part == reference}
    if ohms != {driver.reference_ohm}:
        yield f"REXT: {ohms} ohm are wired, the profile says {driver.reference_ohm:g}"
    channel_ma = largest_ma(driver)
    allowed_ma = min(light.max_ma or 0.0 for light in profile.lights)
    if channel_ma > allowed_ma:
        yield f"{driver.chip}: lets {channel_ma:.1f} mA through, LEDs carry {allowed_ma:g} mA"
    heat_w, drawn_ma = 0.0, 0.0
    for led in wiring.leds:
        low, high = FORWARD_VOLTS[led.colour]
        if high + OUTPUT_DROP_V > WEAKEST_SUPPLY_V:
            yield f"{led.light}: {high:g} V of the LED leave too little for the driver's output"
        ma = channel_ma if led.light != "indicator" else led.current_ma
        drawn_ma += ma * len(led.channels)
        heat_w += 1e-3 * ma * len(led.channels) * (VOLTS["5V"] - low)
    if heat_w > MAX_HEAT_W:
        yield f"{driver.chip}: turns {heat_w:.2f} W into heat with every LED at its limit"
    if drawn_ma > LED_SUPPLY_MA:
        yield f"5V: LEDs draw {drawn_ma:.0f} mA"
    for part, ties in wiring.parts:
        if part == "indicator":
            series = re.search(r"([\d.]+) ohm in series", ties[0])
            ma = (VOLTS["3V3"] - FORWARD_VOLTS["R"][0]) / float(series[1]) * 1e3 if series else GPIO_MA + 1.0
            if ma > GPIO_MA:
                yield f"indicator: takes {ma:.1f} mA of a pin"
    for net, pins in nets.items():
        if any(pin.role == "output" for pin in pins):
            pull_ma = sum(VOLTS["3V3"] / pin.value * 1e3 for pin in pins if pin.role == "pull" and pin.value)
            if pull_ma > GPIO_MA:
                yield f"{net}: the pull takes {pull_ma:.1f} mA of a pin"
