"""The boards to order: the light driver's carrier, and the board of one light.

What is connected to what follows from the net lists of the boards whose light driver is a PCA9955B; one carrier serves
all of them, with the parts that each asks for. Where the parts stand is said here; tracks are read from board/pcb.
"""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path
from typing import Final

from hal.board_profile import load_board_profile
from tests.drawings.board.netlist import netlist
from tests.drawings.board.wiring import wired_boards, wiring
from tests.drawings.pcb.layout import Board, Hole, Part, Point, Track, Via
from tests.drawings.pcb.packages import led, pin_header, pin_row, tssop28, wired

FOLDER: Final = Path(__file__).parents[3] / "board" / "pcb"
CHIP: Final = "PCA9955B"

CHIP_PINS: Final = (
    "REXT", "AD0", "AD1", "AD2", "OE", "LED0", "LED1", "LED2", "LED3", "VSS", "LED4", "LED5", "LED6", "LED7",
    "LED8", "LED9", "LED10", "LED11", "VSS", "LED12", "LED13", "LED14", "LED15", "VSS", "RESET", "SCL", "SDA", "VDD",
)  # fmt: skip
"""Pins 1 to 28. NXP's own table was not at hand: compare before you order (board/pcb/README.md)."""

SIZE: Final = (30.0, 60.0)
HOLES: Final = tuple(Hole((x, y), 2.7) for x in (3.0, 27.0) for y in (3.0, 57.0))
CHIP_AT: Final = (17.55, 30.0625)
LIGHT_SIZE: Final = (14.0, 21.0)
LIGHT_CENTRE: Final = (7.0, 6.0)
LED_PITCH: Final = 5.3
LIGHT_HOLE_OFFSET: Final = 4.7
LIGHT_HOLE: Final = 2.2


def boards_served() -> list[str]:
    """Names of the board profiles that this carrier is for."""
    found = []
    for name in wired_boards():
        driver = load_board_profile(name).light_driver
        if driver is not None and driver.chip == CHIP:
            found.append(name)
    return found


def connections() -> dict[tuple[str, str], str]:
    """Net of every part and terminal of the net lists of all boards that are served.

    Raises
    ------
    ValueError
        Two boards put one terminal on different nets: no one carrier serves both.
    """
    found: dict[tuple[str, str], str] = {}
    for board in boards_served():
        for net, pins in netlist(wiring(board)).items():
            for pin in pins:
                if found.setdefault((pin.part, pin.terminal), net) != net:
                    raise ValueError(f"{board}: {pin.part} {pin.terminal} is on {net}, elsewhere on another net")
    return found


def carrier(routed: bool = True) -> Board:
    """The carrier of the light driver; without tracks when not `routed`."""
    at = connections()
    facts = wiring(boards_served()[0])
    header = [
        name if name in {"3V3", "5V", "GND"} else at.get(("header", str(pin)), "")
        for pin, name in enumerate(facts.header, 1)
    ]
    lit = {net for (_, terminal), net in at.items() if terminal == "cathode"}
    chip = ["GND" if pin == "VSS" else at[CHIP, pin] for pin in CHIP_PINS]
    chip = [net if not net.startswith(f"{CHIP} LED") or net in lit else "" for net in chip]
    lights = {light.light: [f"{CHIP} LED{channel}" for channel in light.channels] for light in facts.leds}
    indicator = at["indicator", "anode"]
    resistors = {pin: _value(pin) for pin in ("REXT", "OE")}
    parts: list[Part] = [
        pin_header("J1", "Raspberry Pi, pin by pin", (7.33, 54.35), header),
        tssop28("U1", "PCA9955BTW", CHIP_AT, chip, "GND"),
        wired("R1", resistors["REXT"], "resistor, wired, 10.16 mm", ((13.6, 40.2), (13.6, 50.36)),
              (at[f"resistor at {CHIP} REXT", "1"], at[f"resistor at {CHIP} REXT", "2"]), 1.5),
        wired("R2", resistors["OE"], "resistor, wired, 10.16 mm", ((17.0, 40.2), (17.0, 50.36)),
              (at[f"resistor at {CHIP} OE", "1"], at[f"resistor at {CHIP} OE", "2"]), 1.5),
        wired("R3", "470 ohm", "resistor, wired, 10.16 mm", ((20.4, 40.2), (20.4, 50.36)),
              (indicator, "indicator"), 1.5),
        wired("C1", "100 nF", "capacitor, wired, 2.54 mm", ((20.41, 36.9), (17.87, 36.9)), ("3V3", "GND"), 1.6),
        wired("C2", "100 uF", "electrolytic, wired, 2.0 mm", ((16.0, 14.0), (18.0, 14.0)), ("5V", "GND"), 2.75),
    ]  # fmt: skip
    column = [
        ("J2", "spare of the bus: 3V3, GND, SCL, SDA", ["3V3", "GND", at[CHIP, "SCL"], at[CHIP, "SDA"]]),
        ("J3", "indicator on the driver: anode, cathode", ["5V", f"{CHIP} LED15"]),
        ("J4", "blue: LED+, 1, 2", ["5V", *lights["blue"]]),
        ("J5", "green: LED+, 1, 2", ["5V", *lights["green"]]),
        ("J6", "red: LED+, 1, 2", ["5V", *lights["red"]]),
    ]
    y = 50.5
    for name, value, nets in column:
        parts.append(pin_row(name, value, (26.4, y), nets))
        y -= 2.54 * len(nets) + 0.8
    parts += [
        pin_row("J7", "button: contact, ground", (8.0, 3.0), [at["button", "contact"], "GND"], level=True),
        pin_row("J8", "power fail: signal, ground", (14.0, 3.0), [at["power-fail", "signal"], "GND"], level=True),
        pin_row("J9", "power off: OFF, ground", (20.0, 3.0), [at["power-off", "OFF"], "GND"], level=True),
        pin_row("J10", "indicator on the Pi: anode, cathode", (19.0, 57.0), ["indicator", "GND"], level=True),
        pin_row("J11", "panel: 5 V, ground", (13.0, 57.0), ["5V", "GND"], level=True),
    ]
    vias = tuple(Via("GND", (CHIP_AT[0] + x, CHIP_AT[1] + y)) for x in (-0.8125, 0.8125) for y in (-1.625, 0.0, 1.625))
    # Below the chip: what takes its heat through to the other side.
    under = tuple(
        Track("GND", "bottom", one.at, other.at, 0.7)
        for number, one in enumerate(vias)
        for other in vias[number + 1 :]
        if one.at[0] == other.at[0] or one.at[1] == other.at[1]
    )
    board = Board("carrier", SIZE, tuple(parts), HOLES, vias, under)
    return with_tracks(board) if routed else board


def light() -> Board:
    """The board of one light: two LEDs, whose wires come out of the sleeve, and a plug."""
    x, y = LIGHT_CENTRE
    half = LED_PITCH / 2
    nets = ("LED+", "channel 1", "channel 2")
    plug_y = 17.0
    parts = (
        led("D1", "LED, 5 mm", (x, y + half), (nets[1], nets[0]), cathode_up=True),
        led("D2", "LED, 5 mm", (x, y - half), (nets[2], nets[0]), cathode_up=False),
        pin_row("J1", "LED+, 1, 2", (x - 2.54, plug_y), nets, level=True),
    )
    holes = tuple(Hole((x + side * LIGHT_HOLE_OFFSET, y), LIGHT_HOLE) for side in (-1, 1))
    return with_tracks(Board("light", LIGHT_SIZE, parts, holes))


def with_tracks(board: Board) -> Board:
    """The board with the tracks and vias of its file in board/pcb."""
    tracks, vias = list(board.tracks), list(board.vias)
    with (FOLDER / f"{board.name}.tracks.csv").open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            start: Point = (float(row["x1"]), float(row["y1"]))
            if row["layer"] == "via":
                vias.append(Via(row["net"], start))
            else:
                layer = "top" if row["layer"] == "top" else "bottom"
                end = (float(row["x2"]), float(row["y2"]))
                tracks.append(Track(row["net"], layer, start, end, float(row["width"])))
    return replace(board, tracks=tuple(tracks), vias=tuple(vias))


def _value(pin: str) -> str:
    """Resistance at a pin of the chip, the same on every board that is served."""
    found = {
        one.value
        for board in boards_served()
        for pins in netlist(wiring(board)).values()
        for one in pins
        if one.part == f"resistor at {CHIP} {pin}"
    }
    (ohm,) = found
    return f"{ohm:g} ohm"
