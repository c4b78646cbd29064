"""The boards to order keep their rules, and carry what wiring, bill of materials, housing and profiles say."""

import csv
import io
import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hal.board_profile import load_board_profile
from hal.drivers.lights_pca9955b import Pca9955b
from tests.drawings.board.wiring import wired_boards, wiring
from tests.drawings.pcb.designs import CHIP, CHIP_PINS, LED_PITCH, boards_served, carrier, light
from tests.drawings.pcb.fabrication import files
from tests.drawings.pcb.layout import Board, Hole, Track, Via
from tests.drawings.pcb.rules import complaints

BOARD = Path(__file__).parents[2] / "board"
BILL = (BOARD / "bill-of-materials.md").read_text(encoding="utf-8")
CARRIER = carrier()
LIGHT = light()
ACROSS = Track("LED+", "bottom", (2.0, 15.0), (12.0, 15.0), 0.3)


def net_of(board: Board, part: str, pin: str | int) -> str:
    (net,) = {pad.net for name, pad in board.pads() if (name, pad.name) == (part, str(pin))}
    return net


def chip_net(pin: str) -> str:
    (net,) = {net_of(CARRIER, "U1", number) for number, name in enumerate(CHIP_PINS, 1) if name == pin}
    return net


@pytest.mark.parametrize("board", [CARRIER, LIGHT], ids=lambda board: board.name)
def test_a_board_keeps_every_rule(board: Board) -> None:
    assert complaints(board) == []


def test_it_serves_every_board_with_its_driver() -> None:
    assert set(boards_served()) == set(wired_boards()) - {"zero2w-imx708"}


@pytest.mark.parametrize("board", boards_served())
def test_every_wire_of_the_header_arrives(board: str) -> None:
    """Pin n of the carrier's header is pin n of the Pi's, and ends where the wiring has it."""
    wired = wiring(board)
    ends = {
        "button contact": ("J7", 1), "button ground": ("J7", 2),
        "power-fail signal": ("J8", 1), "power-fail ground": ("J8", 2),
        "power-off OFF": ("J9", 1), "power-off ground": ("J9", 2),
        "panel +5V": ("J11", 1), "panel ground": ("J11", 2),
        "indicator ground": ("J10", 2), "indicator anode": ("R3", 1),
    }  # fmt: skip
    for wire in wired.wires:
        here = net_of(CARRIER, "J1", wire.pin)
        if wire.part == CHIP and wire.terminal != "LED+":
            assert chip_net(wire.terminal) == here, wire
        elif wire.part == CHIP:
            assert {net_of(CARRIER, plug, 1) for plug in ("J4", "J5", "J6")} == {here}
        else:
            assert net_of(CARRIER, *ends[f"{wire.part} {wire.terminal}"]) == here, wire


@pytest.mark.parametrize("board", boards_served())
def test_lights_hang_on_the_channels_of_the_profile(board: str) -> None:
    profile = load_board_profile(board)
    for one, plug in zip(profile.lights, ("J6", "J5", "J4"), strict=True):
        (part,) = [part for part in CARRIER.parts if part.name == plug]
        assert part.value.startswith(one.name)
        assert [net_of(CARRIER, plug, pin) for pin in (2, 3)] == [chip_net(f"LED{channel}") for channel in one.channels]
    if profile.indicator and profile.indicator.channel is not None:
        assert net_of(CARRIER, "J3", 2) == chip_net(f"LED{profile.indicator.channel}")
    elif profile.indicator:
        (ohm,) = re.findall(r"any (\d+) Ω, 5 %, 1/4 W, wired \| A \| pi4-imx477 ", BILL)
        assert (net_of(CARRIER, "R3", 2), value("R3")) == (net_of(CARRIER, "J10", 1), f"{ohm} ohm")


def value(part: str) -> str:
    (found,) = [one.value for one in CARRIER.parts if one.name == part]
    return found


@pytest.mark.parametrize("board", boards_served())
def test_the_reference_resistor_keeps_the_chip_below_what_leds_carry(board: str) -> None:
    profile = load_board_profile(board)
    assert profile.light_driver is not None
    assert {net_of(CARRIER, "R1", 1), net_of(CARRIER, "R1", 2)} == {chip_net("REXT"), "GND"}
    ohm = float(value("R1").removesuffix(" ohm"))
    assert ohm == profile.light_driver.reference_ohm
    unused: Any = None
    for one in profile.lights:
        assert one.max_ma is not None
        assert Pca9955b(unused, ohm).max_ma <= one.max_ma
    assert f"{ohm / 1e3:.2f} kΩ" in BILL


@pytest.mark.parametrize("board", boards_served())
def test_lights_are_dark_and_the_address_is_right_by_what_is_soldered(board: str) -> None:
    driver = load_board_profile(board).light_driver
    assert driver is not None
    assert {net_of(CARRIER, "R2", 1), net_of(CARRIER, "R2", 2)} == {chip_net("OE"), "3V3"}
    assert value("R2") == "10000 ohm"
    assert chip_net("RESET") == chip_net("VDD") == "3V3"
    level = {"GND": 0, "3V3": 4}
    assert 1 + sum(weight * level[chip_net(pin)] for pin, weight in (("AD2", 25), ("AD1", 5), ("AD0", 1))) == (
        driver.address
    )


def test_ground_takes_every_pin_that_is_ground() -> None:
    """That no board uses some of the header's ground and supply pins does not leave them open."""
    grounds = [number for number, name in enumerate(CHIP_PINS, 1) if name == "VSS"]
    assert {net_of(CARRIER, "U1", number) for number in [*grounds, 29]} == {"GND"}
    for number, name in enumerate(wiring("pi5-imx296").header, 1):
        assert name not in {"3V3", "5V", "GND"} or net_of(CARRIER, "J1", number) == name


def test_a_part_for_every_row_of_the_bill() -> None:
    rows = {"PCA9955BTW": "U1", "2.40 kΩ": "R1", "10 kΩ, 5 %": "R2", "470 Ω": "R3", "100 nF": "C1", "100 µF": "C2"}
    for words, part in rows.items():
        assert words in BILL
        assert part in {one.name for one in CARRIER.parts}


def test_holes_fit_the_housing() -> None:
    housing = (BOARD / "enclosure" / "retrograph.scad").read_text(encoding="utf-8")
    found = re.search(r"carrier_holes = \[for \(x = \[(\d+), (\d+)\], y = \[(\d+), (\d+)\]\)", housing)
    assert found
    left, right, low, high = (float(one) for one in found.groups())
    across, up = sorted({hole.at[0] for hole in CARRIER.holes}), sorted({hole.at[1] for hole in CARRIER.holes})
    assert (across[1] - across[0], up[1] - up[0]) == (right - left, high - low)
    m25 = re.search(r"^m25 = ([\d.]+);", housing, re.MULTILINE)
    assert m25
    assert {2.5 < hole.drill <= float(m25[1]) for hole in CARRIER.holes} == {True}
    assert f"{CARRIER.size[0]:g} × {CARRIER.size[1]:g} mm" in BILL


def test_a_light_board_is_screwed_to_its_sleeve() -> None:
    housing = (BOARD / "enclosure" / "retrograph.scad").read_text(encoding="utf-8")
    apart, tapped = (
        re.search(rf"^{name} = ([\d.]+);", housing, re.MULTILINE) for name in ("light_board_holes", "m2_tapped")
    )
    assert apart
    assert tapped
    left, right = LIGHT.holes
    assert right.at[0] - left.at[0] == pytest.approx(float(apart[1]))
    assert float(tapped[1]) < 2.0 < left.drill == right.drill
    # Midway between the LEDs, as in the sleeve.
    assert left.at[1] == right.at[1] == pytest.approx(sum(part.at[1] for part in LIGHT.parts[:2]) / 2)


def test_light_boards_with_their_plugs_clear_tray_and_lugs() -> None:
    """Every corner of board (with solder, 3.6 mm thick) and plug (11 mm high), set with the plug away from the tray."""
    housing = (BOARD / "enclosure" / "retrograph.scad").read_text(encoding="utf-8")

    def length(name: str) -> float:
        found = re.search(rf"^{name} = ([\d.]+);", housing, re.MULTILINE)
        assert found, name
        return float(found[1])

    outer_r = length("inner_r") + length("wall")
    cosine = math.cos(math.radians(length("elevation"))) * length("n_gel") / length("n_block")
    sine = math.sqrt(1.0 - cosine**2)
    back = (outer_r + 3) / cosine + 1
    middle = (LIGHT.holes[0].at[0] + LIGHT.holes[1].at[0]) / 2, LIGHT.holes[0].at[1]
    for one in load_board_profile("pi5-imx296").lights:
        azimuth = math.atan2(one.position_mm[1], one.position_mm[0])
        for across in np.linspace(-middle[0], LIGHT.size[0] - middle[0], 15):
            for along in np.linspace(-middle[1], LIGHT.size[1] - middle[1], 23):
                for out in (back, back + (11.0 if along > 8.0 else 3.6)):
                    radial, z = out * cosine + across * sine, out * sine - across * cosine
                    x = radial * math.cos(azimuth) - along * math.sin(azimuth)
                    y = radial * math.sin(azimuth) + along * math.cos(azimuth)
                    assert x < outer_r + 8, f"{one.name}: the tray is in the way"
                    assert not (abs(y) < 7 and x > 0 and 31 < z < 45), f"{one.name}: a lug is in the way"


@pytest.mark.parametrize("board", wired_boards())
def test_the_leds_of_a_light_board_stand_as_every_profile_has_them(board: str) -> None:
    """The light board knows no driver: it also serves the board that the carrier does not."""
    profile = load_board_profile(board)
    beam = profile.beam
    assert beam is not None
    assert [len(light.channels) for light in profile.lights] == [2, 2, 2]
    assert len(beam.led_offsets_mm) == 2
    assert pytest.approx(beam.led_offsets_mm[1] - beam.led_offsets_mm[0]) == LED_PITCH
    first, second = (part.at for part in LIGHT.parts[:2])
    assert (first[0] - second[0], first[1] - second[1]) == pytest.approx((0.0, LED_PITCH))
    assert net_of(LIGHT, "D1", 2) == net_of(LIGHT, "D2", 2) == net_of(LIGHT, "J1", 1) == "LED+"
    assert [net_of(LIGHT, f"D{one}", 1) for one in (1, 2)] == [net_of(LIGHT, "J1", pin) for pin in (2, 3)]


def _without_a_track(board: Board) -> Board:
    return replace(board, tracks=board.tracks[1:])


def _tracks(**change: Any) -> Callable[[Board], Board]:
    return lambda board: replace(board, tracks=(replace(board.tracks[0], **change), *board.tracks[1:]))


def _part(number: int, **change: Any) -> Callable[[Board], Board]:
    def changed(board: Board) -> Board:
        parts = list(board.parts)
        parts[number] = replace(parts[number], **change)
        return replace(board, parts=tuple(parts))

    return changed


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (_without_a_track, "are not joined to"),
        (_tracks(width=0.1), "thinner than 0.2 mm"),
        (_tracks(net="channel 1"), "mm from"),
        (_tracks(end=(13.9, 4.62)), "to the board's edge"),
        (_part(0, courtyard=(4.0, 3.0, 10.0, 12.0)), "take the same room"),
        (_part(0, pads=tuple(replace(pad, drill=1.5) for pad in LIGHT.parts[0].pads)), "ring around its hole"),
        (lambda board: replace(board, holes=(Hole((7.0, 14.0), 2.2),)), "to the hole at"),
        (lambda board: replace(board, holes=(*board.holes, Hole((2.3, 8.0), 2.2))), "0.25 mm to each other"),
        (lambda board: replace(board, vias=(Via("LED+", (4.46, 14.0), 0.5, 0.3),)), "ring or hole is too small"),
        (lambda board: replace(board, tracks=(*board.tracks, ACROSS)), "is -0.350 mm from track"),
    ],
)  # fmt: skip
def test_a_mistake_is_found(change: Callable[[Board], Board], complaint: str) -> None:
    found = complaints(change(LIGHT))
    assert any(complaint in one for one in found), found


def test_pick_and_place_has_every_part_and_says_what_a_machine_sets() -> None:
    rows = list(csv.DictReader(io.StringIO(files(CARRIER)["carrier-places.csv"])))
    assert [row["designator"] for row in rows] == [part.name for part in CARRIER.parts]
    assert [row["designator"] for row in rows if row["by"] == "machine"] == ["U1"]
    (chip,) = [row for row in rows if row["designator"] == "U1"]
    (at,) = [part.at for part in CARRIER.parts if part.name == "U1"]
    assert (float(chip["x_mm"]), float(chip["y_mm"])) == pytest.approx(at, abs=1e-3)
