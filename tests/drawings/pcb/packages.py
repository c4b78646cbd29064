"""Footprints of the parts of the boards: pads and the room that each takes.

Pad sizes follow what KiCad's own library has for these packages; the data sheet of a part that is bought decides.
"""

from __future__ import annotations

from collections.abc import Sequence

from tests.drawings.pcb.layout import Pad, Part, Point

PITCH = 2.54
ROOM = 0.25
"""Around a part's body, mm."""


def pin_row(name: str, value: str, first: Point, nets: Sequence[str], level: bool = False) -> Part:
    """A pin header of one row, pin 1 at `first`, the others below it, or to its right when `level`."""
    step = (PITCH, 0.0) if level else (0.0, -PITCH)
    pads = tuple(
        Pad(str(i + 1), (first[0] + i * step[0], first[1] + i * step[1]), (1.7, 1.7), 1.0, net, i > 0)
        for i, net in enumerate(nets)
    )
    return _around(name, value, f"pin header 1x{len(nets)}, 2.54 mm", pads, 1.27 + ROOM)


def pin_header(name: str, value: str, first: Point, nets: Sequence[str]) -> Part:
    """A pin header of two rows as a Raspberry Pi has it: odd pins at the left, pin 1 above."""
    pads = tuple(
        Pad(str(i + 1), (first[0] + i % 2 * PITCH, first[1] - i // 2 * PITCH), (1.7, 1.7), 1.0, net, i > 0)
        for i, net in enumerate(nets)
    )
    return _around(name, value, f"pin header 2x{len(nets) // 2}, 2.54 mm", pads, 1.27 + ROOM)


def wired(name: str, value: str, package: str, ends: tuple[Point, Point], nets: tuple[str, str], room: float) -> Part:
    """A part with two wires: resistor or capacitor; `room` is half of its width."""
    pads = tuple(
        Pad(str(i + 1), at, (1.6, 1.6), 0.8, net, not (i == 0 and "electrolytic" in package))
        for i, (at, net) in enumerate(zip(ends, nets, strict=True))
    )
    return _around(name, value, package, pads, room)


def led(name: str, value: str, centre: Point, nets: tuple[str, str], cathode_up: bool) -> Part:
    """A 5 mm LED on its two wires, 2.54 mm apart along y; pin 1 is the cathode, as KiCad has it."""
    up = PITCH / 2 if cathode_up else -PITCH / 2
    ends = ((centre[0], centre[1] + up), (centre[0], centre[1] - up))
    pads = tuple(
        Pad(str(i + 1), at, (1.6, 1.6), 0.9, net, i > 0) for i, (at, net) in enumerate(zip(ends, nets, strict=True))
    )
    box = (centre[0] - 2.6, centre[1] - 2.6, centre[0] + 2.6, centre[1] + 2.6)
    return Part(name, value, "LED 5 mm, wired", centre, pads, box)


def tssop28(name: str, value: str, centre: Point, nets: Sequence[str], under: str) -> Part:
    """HTSSOP-28, body 4.4 x 9.7 mm, 0.65 mm pitch, pin 1 at the upper left; pin 29 is the pad under the chip."""
    x, y = centre
    places = [(x - 2.8625, y + 4.225 - 0.65 * i) for i in range(14)]
    places += [(x + 2.8625, y - 4.225 + 0.65 * i) for i in range(14)]
    pads = [Pad(str(i + 1), at, (1.475, 0.4), 0.0, net) for i, (at, net) in enumerate(zip(places, nets, strict=True))]
    pads.append(Pad("29", centre, (2.85, 5.4), 0.0, under))
    return Part(name, value, "HTSSOP-28", centre, tuple(pads), (x - 3.85, y - 5.1, x + 3.85, y + 5.1))


def _around(name: str, value: str, package: str, pads: tuple[Pad, ...], room: float) -> Part:
    across, up = [pad.at[0] for pad in pads], [pad.at[1] for pad in pads]
    box = (min(across) - room, min(up) - room, max(across) + room, max(up) + room)
    return Part(name, value, package, ((box[0] + box[2]) / 2, (box[1] + box[3]) / 2), pads, box)
