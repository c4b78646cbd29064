"""The panel of the exposure: light on the skin as it is now, and the exposure balance with what it found."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from device.acquisition.auto_exposure import ExposureBalance
from device.acquisition.capture import CaptureSettings
from device.imaging.exposure import HIGHEST_LEVEL
from device.instrument.state import BalanceProgress, InstrumentState
from device.tui.drawing.advice import screen_advice
from device.tui.drawing.text import gauge_text, hanging

MAX_BAR_COLUMNS: Final = 40
_FULL: Final = 1.0

_MEANING: Final = (
    "Enter balances: a ball is pressed near each light, then exposure and currents use the sensor's range. The active "
    "calibration keeps its own; the next calibration uses the new ones."
)


def exposure_panel(state: InstrumentState, columns: int) -> str:
    """Light on the skin, and what an exposure balance is to do, does or has found."""
    names = list(state.health.light_change)
    bars, balance = level_lines(state, names, min(columns, MAX_BAR_COLUMNS)), state.balance
    if state.activity == "balancing" and balance:
        return "\n".join([*_step_lines(balance, len(names), columns), "", *bars])
    if balance and balance.found:
        return "\n".join([*balance_lines(balance.found, columns), "", hanging(balance.instruction, columns, 0)])
    failed = [f"! {screen_advice(balance.instruction)}"] if balance else []
    light = state.next_light
    using = [] if light is None else [f"Next calibration, {'balanced' if light.is_balanced else 'board profile'}:"]
    plan = [] if light is None else [f"  {plan_text(light.plan)}"]
    words = [hanging(line, columns, 2) for line in (*using, *plan, *failed)]
    return "\n".join([*bars, "", *words, "", hanging(_MEANING, columns, 0)])


def level_lines(state: InstrumentState, names: Sequence[str], columns: int) -> list[str]:
    """A bar for each light, and what is saturated."""
    found = state.levels
    if found is None:
        return ["Waiting for the camera."]
    bars = [gauge_text(name[:8], level, columns) for name, level in zip(names, found.median, strict=True)]
    clipped = ", ".join(f"{share:.1%}" for share in found.clipped)
    return ["Light on the skin, of full scale:", *bars, f"saturated pixels: {clipped}"]


def plan_text(plan: CaptureSettings) -> str:
    """Exposure and currents in a line."""
    currents = ", ".join(f"{name} {current:.1f}" for name, current in plan.currents_ma.items())
    return f"{plan.settings.exposure_us:.0f} µs; {currents} mA"


def balance_lines(found: ExposureBalance, columns: int) -> list[str]:
    """Before and after, and what limits it."""
    before, after = found.before, found.plan
    rows = [
        (name, f"{before.currents_ma[name]:.1f} mA", f"{current:.1f} mA") for name, current in after.currents_ma.items()
    ]
    exposures = ("exposure", f"{before.settings.exposure_us:.0f} µs", f"{after.settings.exposure_us:.0f} µs")
    levels = zip(after.currents_ma, found.before_predicted, found.predicted, strict=True)
    balls = [(f"ball, {name}", _level_text(was), _level_text(now)) for name, was, now in levels]
    table = [f"{name:<12}{was:>11}{now:>11}" for name, was, now in (("", "before", "after"), *rows, exposures, *balls)]
    limit = found.limit or f"Nothing limits it: balls stay below {HIGHEST_LEVEL:.0%} of full scale."
    return [*table, "", hanging(limit, columns, 0)]


def _level_text(level: float) -> str:
    return "saturated" if level >= _FULL else f"{level:.0%}"


def _step_lines(balance: BalanceProgress, wanted: int, columns: int) -> list[str]:
    gauge = gauge_text(
        "presses", balance.taken / wanted, min(columns, MAX_BAR_COLUMNS), f" {balance.taken} of {wanted}"
    )
    return [gauge, hanging(balance.instruction, columns, 0), "Enter takes it too; x stops."]
