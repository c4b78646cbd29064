"""What a board draws from its 5 V supply, and how long a charge lasts: makers' figures, else estimates."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from hal.board_profile import load_board_profile
from tests.drawings.board.electrical_rules import largest_ma
from tests.drawings.board.wiring import wiring

CAMERA_MA: Final = 250.0
"""Of a camera module, as Raspberry Pi states it."""

PANEL_MA: Final = 1000.0
"""Of the first 7-inch panel at full brightness, at most."""


@dataclass(frozen=True, slots=True)
class Supply:
    """A supply and the computer behind it.

    active_ma, busy_ma : of the computer alone: typical as its maker states it, and with every core at work
    limit_ma : what the supply gives
    charge_mah : what one charge gives at 5 V
    takes_panel : whether a panel hangs on it
    """

    active_ma: float
    busy_ma: float
    limit_ma: float
    charge_mah: float
    takes_panel: bool


BANK_MAH: Final = 5800.0
"""Of a power bank of 10,000 mAh at 3.6 V, as makers rate it at 5 V."""

SUPPLIES: Final = {
    "pi4-imx477": Supply(600.0, 1250.0, 3000.0, BANK_MAH, True),
    "pi5-imx296": Supply(800.0, 1600.0, 3000.0, BANK_MAH, True),
    "zero2w-imx708": Supply(350.0, 600.0, 1000.0, 2500.0 * 3.7 * 0.85 / 5.0, False),
}
"""Raspberry Pi's figures but for the busy Pi 5 and Zero 2 W, which are estimates; the Zero's cell has 2500 mAh."""


def live_ma(board: str) -> float:
    """Current while the instrument waits for a push: the camera streams and the lights shine."""
    lights_ma = sum(led.current_ma * len(led.channels) for led in wiring(board).leds)
    return SUPPLIES[board].active_ma + CAMERA_MA + lights_ma


def peak_ma(board: str) -> float:
    """Current while a scan is worked out: every light at its driver's limit, with a panel where there may be one."""
    supply, profile = SUPPLIES[board], load_board_profile(board)
    assert profile.light_driver is not None
    lights_ma = largest_ma(profile.light_driver) * sum(len(light.channels) for light in profile.lights)
    return supply.busy_ma + CAMERA_MA + lights_ma + (PANEL_MA if supply.takes_panel else 0.0)


def power_table() -> Iterator[str]:
    """Rows of the bill's table on current and run time."""
    yield "| board | waiting | scan, with panel | supply gives | a charge lasts | with panel |"
    yield "|---|---|---|---|---|---|"
    for board, supply in SUPPLIES.items():
        waiting = live_ma(board)
        panel = f"{supply.charge_mah / (waiting + PANEL_MA):.1f} h" if supply.takes_panel else "–"
        cells = f"{waiting * 1e-3:.1f} A | {peak_ma(board) * 1e-3:.1f} A | {supply.limit_ma * 1e-3:.0f} A"
        yield f"| {board} | {cells} | {supply.charge_mah / waiting:.1f} h | {panel} |"
