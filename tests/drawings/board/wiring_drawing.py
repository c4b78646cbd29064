"""The wiring of one board as a drawing: the header on top as seen from above, parts below, one line per wire.

Every wire leaves its pin downwards, runs along its own lane and enters its terminal from above. Colour never carries
information alone: each end is labelled with pin and terminal.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby
from xml.sax.saxutils import escape

from tests.drawings.board.wiring import Led, Wire, Wiring

WIDTH = 1240
PIN_PITCH = 46
HEADER_LEFT, ODD_Y, EVEN_Y = 160, 134, 96
LANES_TOP, LANE_PITCH = 176, 15
TERMINAL_PITCH = 62
MARGIN = 40
COLOURS = {"supply": "#c0392b", "ground": "#333333", "sda": "#1f6fb2", "scl": "#b7791f", "line": "#2e7d32"}
LIGHT_COLOURS = {"R": "#c0392b", "G": "#2e7d32", "B": "#1f6fb2", "any": "#777777"}


@dataclass(frozen=True, slots=True)
class Place:
    """A part's box: its left edge, its width, and the x of each terminal."""

    left: float
    width: float
    terminals: dict[str, float]


def drawing(wiring: Wiring) -> str:
    """The drawing as SVG text."""
    box_top = LANES_TOP + LANE_PITCH * len(wiring.wires) + 34
    ties = max(len(part_ties) for _, part_ties in wiring.parts)
    box_height = 52 + 15 * ties
    led_top = box_top + box_height + 62
    height = led_top + 130
    places = _places(wiring)
    body = [
        *_header(wiring),
        *_wires(wiring, places, box_top),
        *_boxes(wiring, places, box_top, box_height),
        *_leds(wiring, places[wiring.parts[0][0]], box_top + box_height, led_top),
    ]
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" '
            f'font-family="DejaVu Sans, Helvetica, sans-serif" font-size="12" fill="#111111">',
            f'<rect width="{WIDTH}" height="{height}" fill="#ffffff"/>',
            _text(MARGIN, 34, f"Wiring of {wiring.title}", 'font-size="18" font-weight="bold"'),
            _text(MARGIN, 54, "The header as it lies before you, USB ports to the right; pins are physical pins."),
            *body,
            "</svg>",
            "",
        ]
    )


def _places(wiring: Wiring) -> dict[str, Place]:
    """Boxes side by side, as wide as their terminals need, spread over the width."""
    counts = {part: [wire.terminal for wire in wiring.wires if wire.part == part] for part, _ in wiring.parts}
    widths = {part: TERMINAL_PITCH * len(terminals) + 14 for part, terminals in counts.items()}
    gap = (WIDTH - 2 * MARGIN - sum(widths.values())) / max(len(widths) - 1, 1)
    places, left = {}, float(MARGIN)
    for part, terminals in counts.items():
        spots = {name: left + 7 + TERMINAL_PITCH * (index + 0.5) for index, name in enumerate(terminals)}
        places[part] = Place(left, widths[part], spots)
        left += widths[part] + min(gap, 60.0)
    return places


def _header(wiring: Wiring) -> Iterator[str]:
    width = PIN_PITCH * 20 + 20
    yield f'<rect x="{HEADER_LEFT - 33}" y="70" width="{width}" height="84" rx="6" fill="#eef0f3" stroke="#555555"/>'
    used = {wire.pin: wire.kind for wire in wiring.wires}
    for pin, name in enumerate(wiring.header, start=1):
        x, y = _pin_at(pin)
        fill = COLOURS[used[pin]] if pin in used else "#ffffff"
        shape = (
            f'<rect x="{x - 7}" y="{y - 7}" width="14" height="14"' if pin == 1 else f'<circle cx="{x}" cy="{y}" r="7"'
        )
        yield f'{shape} fill="{fill}" stroke="#555555"/>'
        weight = 'font-weight="bold"' if pin in used else 'fill="#777777"'
        label = y - 12
        yield _text(x, label, f"{pin} {name}", f'font-size="7" text-anchor="middle" {weight}')


def _pin_at(pin: int) -> tuple[float, float]:
    """Centre of a pin; the odd row is the lower one."""
    return HEADER_LEFT + PIN_PITCH * ((pin - 1) // 2), ODD_Y if pin % 2 else EVEN_Y


def _wires(wiring: Wiring, places: dict[str, Place], box_top: float) -> Iterator[str]:
    """Wires by pin from left to right; those of one pin leave it side by side, an even pin's between the columns."""
    ordered = sorted(wiring.wires, key=lambda wire: (_leaving_x(wire.pin), -places[wire.part].terminals[wire.terminal]))
    lane = len(ordered)
    for pin, group in groupby(ordered, key=lambda wire: wire.pin):
        together = list(group)
        for index, wire in enumerate(together):
            lane -= 1
            shift = 5.0 * (index - (len(together) - 1) / 2)
            yield _path(
                wire, pin, shift, LANES_TOP + LANE_PITCH * lane, places[wire.part].terminals[wire.terminal], box_top
            )


def _leaving_x(pin: int) -> float:
    return _pin_at(pin)[0] + (0.0 if pin % 2 else PIN_PITCH / 2)


def _path(wire: Wire, pin: int, shift: float, lane_y: float, end_x: float, box_top: float) -> str:
    x, y = _pin_at(pin)
    out = _leaving_x(pin) + shift
    start = f"M{x + 7} {y} H{out}" if pin % 2 == 0 else f"M{out} {y + 7}"
    label = f"<title>{escape(f'pin {pin} {wire.pin_name} to {wire.part} {wire.terminal}')}</title>"
    colour = COLOURS[wire.kind]
    dot = f'<circle cx="{end_x}" cy="{box_top}" r="3" fill="{colour}"/>'
    path = f'<path d="{start} V{lane_y} H{end_x} V{box_top}" fill="none" stroke="{colour}" stroke-width="2"/>'
    return f"<g>{label}{path}{dot}</g>" + _text(end_x + 4, box_top - 6, str(pin), f'font-size="9" fill="{colour}"')


def _boxes(wiring: Wiring, places: dict[str, Place], top: float, height: float) -> Iterator[str]:
    for part, ties in wiring.parts:
        place = places[part]
        shape = f'<rect x="{place.left}" y="{top}" width="{place.width}" height="{height}" rx="5"'
        yield f'{shape} fill="#f7f7f2" stroke="#555555"/>'
        for name, x in place.terminals.items():
            yield _text(x, top + 15, name, 'font-size="10" text-anchor="middle"')
        yield _text(place.left + 10, top + 36, part, 'font-size="14" font-weight="bold"')
        lines = [line for tie in ties for line in _wrapped(tie, int(place.width / 5.6))]
        for row, line in enumerate(lines):
            yield _text(place.left + 10, top + 53 + 13 * row, line, 'font-size="10"')


def _wrapped(text: str, columns: int) -> list[str]:
    lines = [""]
    for word in text.split():
        if lines[-1] and len(lines[-1]) + len(word) >= columns:
            lines.append("")
        lines[-1] = f"{lines[-1]} {word}".strip()
    return lines


def _leds(wiring: Wiring, driver: Place, box_bottom: float, top: float) -> Iterator[str]:
    """The LEDs of each light, and the indicator LED, below the driver: cathodes to channels, anodes to one rail."""
    rail = top + 84
    pitch = 46
    spots = [(led, channel) for led in wiring.leds for channel in led.channels]
    left = driver.left + 24
    yield f'<path d="M{left} {rail} H{left + pitch * (len(spots) - 1)}" stroke="{COLOURS["supply"]}" stroke-width="2"/>'
    feed = next(wire for wire in wiring.wires if wire.terminal == "LED+")
    label = f"LED+ (header pin {feed.pin}, {feed.pin_name})"
    yield _text(left + pitch * (len(spots) - 1) + 16, rail + 4, label, 'font-size="11"')
    for index, (led, channel) in enumerate(spots):
        yield from _led(led, f"{wiring.channel_name}{channel}", left + pitch * index, box_bottom, top, rail)
    for led, group in groupby(enumerate(spots), key=lambda spot: spot[1][0]):
        indices = [index for index, _ in group]
        x = left + pitch * sum(indices) / len(indices)
        for row, line in enumerate((led.light, f"{led.current_ma:g} mA")):
            yield _text(x, rail + 18 + 13 * row, line, 'font-size="10" text-anchor="middle"')


def _led(led: Led, channel: str, x: float, box_bottom: float, top: float, rail: float) -> Iterator[str]:
    colour = LIGHT_COLOURS[led.colour]
    yield _text(x + 4, box_bottom + 14, channel, 'font-size="9"')
    yield f'<path d="M{x} {box_bottom} V{top + 22} M{x} {top + 44} V{rail}" stroke="{colour}" stroke-width="2"/>'
    # The triangle points from anode to cathode: upwards.
    yield f'<path d="M{x - 11} {top + 44} H{x + 11} L{x} {top + 24} Z" fill="{colour}"/>'
    yield f'<path d="M{x - 11} {top + 22} H{x + 11}" stroke="{colour}" stroke-width="3"/>'


def _text(x: float, y: float, text: str, style: str = "") -> str:
    return f'<text x="{x:g}" y="{y:g}"{" " + style if style else ""}>{escape(text)}</text>'
