"""The pin map of one board, its LEDs and what ties its parts, as Markdown."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby

from tests.drawings.board.wiring import Wiring


def wiring_page(wiring: Wiring) -> str:
    """The page `board/wiring/<board>.md`."""
    return "\n".join(_lines(wiring)) + "\n"


def _lines(wiring: Wiring) -> Iterator[str]:
    yield f"# Wiring of {wiring.title}"
    yield ""
    yield f"`make board` made this page from `board/{wiring.board}.toml` and `board/wiring/wiring.toml`: change those."
    yield ""
    yield f"![Drawing]({wiring.board}.svg)"
    yield ""
    yield f"The [net list]({wiring.board}.nets.csv) has every connection, with the chips' own pins and resistors."
    yield ""
    yield "Odd pins are in the row nearer to the board's middle; pin 1 is at the end without USB ports."
    yield ""
    yield "| used for | name | odd | even | name | used for |"
    yield "|---|---|---|---|---|---|"
    for is_used, rows in groupby(range(1, 41, 2), lambda odd: bool(_use(wiring, odd) or _use(wiring, odd + 1))):
        odds = list(rows)
        if is_used or len(odds) == 1:
            yield from (_row(wiring, odd) for odd in odds)
        else:
            yield f"| free | | {odds[0]}–{odds[-1]} | {odds[0] + 1}–{odds[-1] + 1} | | free |"
    yield ""
    yield "| LEDs | channels, one LED each | current in each |"
    yield "|---|---|---|"
    for led in wiring.leds:
        channels = ", ".join(f"{wiring.channel_name}{channel}" for channel in led.channels)
        yield f"| {led.light} ({led.colour}) | {channels} | {led.current_ma:g} mA |"
    yield ""
    yield "LEDs: anode to LED+, cathode to the driver's channel; no series resistor, the driver sets the current."
    yield ""
    for part, ties in wiring.parts:
        yield f"- **{part}**: {'; '.join(ties)}."


def _row(wiring: Wiring, odd: int) -> str:
    left, right = _use(wiring, odd), _use(wiring, odd + 1)
    return f"| {left} | {wiring.header[odd - 1]} | {odd} | {odd + 1} | {wiring.header[odd]} | {right} |"


def _use(wiring: Wiring, pin: int) -> str:
    return ", ".join(f"{wire.part} {wire.terminal}" for wire in wiring.wires if wire.pin == pin)
