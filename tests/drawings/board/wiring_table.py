"""The pin map of one board, its LEDs and what ties its parts, as Markdown."""

from __future__ import annotations

from collections.abc import Iterator

from tests.drawings.board.wiring import Wiring


def wiring_page(wiring: Wiring) -> str:
    """The page `board/wiring/<board>.md`."""
    return "\n".join(_lines(wiring)) + "\n"


def _lines(wiring: Wiring) -> Iterator[str]:
    yield f"# Wiring of {wiring.title}"
    yield ""
    yield f"Made by `make board` from `board/{wiring.board}.toml` and `board/wiring/wiring.toml`: change those."
    yield ""
    yield f"![Drawing]({wiring.board}.svg)"
    yield ""
    yield (
        f"[Net list]({wiring.board}.nets.csv): every connection, chips' own pins and resistors too. A test runs "
        "electrical rules on it: one driver a net, no floating pin, pulls, levels, currents, heat."
    )
    yield ""
    yield "Odd pins are the row nearer to the board's middle; pin 1 is the one at the end without USB ports."
    yield ""
    yield "| used for | name | odd | even | name | used for |"
    yield "|---|---|---|---|---|---|"
    for odd in range(1, 41, 2):
        left, right = _use(wiring, odd), _use(wiring, odd + 1)
        yield f"| {left} | {wiring.header[odd - 1]} | {odd} | {odd + 1} | {wiring.header[odd]} | {right} |"

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


def _use(wiring: Wiring, pin: int) -> str:
    return ", ".join(f"{wire.part} {wire.terminal}" for wire in wiring.wires if wire.pin == pin)
