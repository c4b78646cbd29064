"""The panels of the set-up screen: instrument, lights and gel, network, storage, pairing, self-test; the state line."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Final

from device.acquisition.auto_exposure import ExposureBalance
from device.acquisition.capture import CaptureSettings
from device.acquisition.selftest import Finding
from device.bundles.check import UNITS, CheckRecord
from device.imaging.frame_light import HIGHEST_LEVEL
from device.imaging.frame_measures import FocusReading
from device.instrument.pairing_run import NetworkInfo
from device.instrument.state import (
    BalanceProgress,
    CalibrationState,
    CheckState,
    HealthState,
    InstrumentState,
    PairingState,
)
from device.tui.drawing.text import (
    age_text,
    clock_text,
    gauge_text,
    hanging,
    percent_text,
    screen_advice,
    shortened,
    signed_percent,
)
from hal.interfaces import PowerReading

_LABEL: Final = 12


@dataclass(frozen=True, slots=True)
class ProgramInfo:
    """Facts that do not change while the program runs: version, folder of scans, whether the board has a gauge."""

    version: str
    store: Path
    has_gauge: bool = False


def instrument_panel(
    state: InstrumentState, program: ProgramInfo, network: NetworkInfo | None, columns: int, now: datetime
) -> str:
    """Return all facts about the instrument, for support."""
    calibration, gel = state.calibration, state.gel
    error = "" if calibration.held_out_deg is None else f", error {calibration.held_out_deg:.1f} degrees"
    left = "unknown" if state.scans_left is None else f"room for {state.scans_left} more"
    stored = "" if state.scans_stored is None else f"{_counted(state.scans_stored)}, "
    lines = [
        ("Device", f"{state.device_id} ({state.board})"),
        *_network_lines(network, columns),
        ("Gel", f"{gel.gel_id}, {gel.slab_thickness_mm:g} mm, pressed {_times(gel.presses)}"),
        ("Skin", skin_text(state.health)),
        (
            "Calibration",
            screen_advice(calibration.fault) or f"{calibration_text(calibration)}{_version(calibration)}{error}",
        ),
        *_brightness_lines(calibration),
        ("Lights", lights_text(state.health)),
        ("Power", battery_text(state, has_gauge=program.has_gauge)),
        ("Storage", f"{stored}{left}"),
        ("Folder", str(program.store)),
        ("Clock", clock_text(now)),
        ("Version", program.version),
    ]
    return _labelled(lines, columns)


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count} times"


def _counted(scans: int) -> str:
    return "1 scan" if scans == 1 else f"{scans} scans"


def _version(calibration: CalibrationState) -> str:
    return "" if calibration.version is None else f", version {calibration.version} ({calibration.slot})"


def _brightness_lines(calibration: CalibrationState) -> list[tuple[str, str]]:
    """Return how much of the sensor's range the calibration uses, if recorded."""
    found = calibration.brightness
    return [] if found is None else [("Brightness", screen_advice(found.warning or found.sentence))]


def lights_text(health: HealthState) -> str:
    """Return how much each light has changed since calibration."""
    seen = [f"{name} {signed_percent(change)}" for name, change in health.light_change.items() if change is not None]
    if not seen:
        return "not measured yet: lift off, so that untouched skin is visible"
    return f"{', '.join(seen)} since calibration"


def skin_text(health: HealthState) -> str:
    """Return defects of the skin, and how flat the last zero check read."""
    fraction = health.defect_fraction
    defects = "not measured yet" if fraction is None else f"{fraction:.1%} of the skin has defects"
    return defects if health.flat_residual_um is None else f"{defects}, flat to {health.flat_residual_um:.1f} µm"


def pairing_panel(pairing: PairingState, network: NetworkInfo | None, now_ns: int, columns: int) -> str:
    """Return how to pair while the window is open, or the code to compare, in large; afterwards the outcome."""
    if not pairing.is_open:
        return hanging(pairing.sentence, columns, 0)
    left_s = max(round((pairing.open_until_ns - now_ns) * 1e-9), 0)
    host = network.host_name if network else "this-instrument"
    if pairing.code:
        code = "   ".join(" ".join(part) for part in pairing.code.split())
        question = "Enter, or the button held for 2 s, lets the workstation in that shows the same code."
        lines = ["", f"  Code    {code}", "", hanging(question, columns, 0), f"{left_s} s left."]
    else:
        lines = ["On the workstation:", f"  retrosync pair {host}.local", "", f"{left_s} s left."]
    return "\n".join([*lines, "", _labelled(_network_lines(network, columns), columns)])


CHART_ROWS: Final = 7


def check_panel(check: CheckState, columns: int) -> str:
    """Return the check standard, today's state, and a chart of its checks.

    The chart has one column per check and the certified value in the middle row.
    """
    standard = check.standard
    if standard is None:
        return "Enter the certified ball, step or roughness specimen that shows each day that results are right."
    unit, factor = UNITS[standard.kind]
    value, tolerance = standard.value_um / factor, standard.tolerance_um / factor
    mine = check.of_standard
    lines = [f"{standard.name}: {standard.kind}, {value:g} ± {tolerance:g} {unit} ({_check_words(check)})", ""]
    others = [hanging(f"! {one.sentence}", columns, 2) for one in check.failed_others]
    if not mine:
        return "\n".join([*lines, "No check of it with this calibration yet.", *others])
    shown = mine[-max(columns - 14, 4) :]
    reach = max(max(abs(_deviation_um(one)) for one in shown), max(one.limit_um for one in shown))
    for row in range(CHART_ROWS, -CHART_ROWS - 1, -2):
        at = reach * row / CHART_ROWS
        cells = "".join(_chart_cell(one, row, reach) for one in shown)
        label = f"{(standard.value_um + at) / factor:8.4g}"
        lines.append(f"{label} │{cells}")
    last = hanging(f"Last: {mine[-1].sentence}", columns, 6)
    return "\n".join([*lines, "", "o passed, x failed, newest right", last, *others])


def _check_words(check: CheckState) -> str:
    """Return what is to be done with the check standard, or the result of its last check today."""
    if check.is_next:
        return "press it, then push the button"
    if check.is_due:
        return "due today"
    if not check.of_standard:
        return "calibrate first"
    return "passed" if check.of_standard[-1].passed else "FAILED: press it again, or calibrate"


def _deviation_um(check: CheckRecord) -> float:
    """Return measured minus certified value; of what did not show, the limit, so that it is drawn at the edge."""
    return check.limit_um if check.measured_um is None else check.measured_um - check.value_um


def _chart_cell(check: CheckRecord, row: int, reach: float) -> str:
    """Return a check's sign if its deviation falls into this row of the chart."""
    place = _deviation_um(check) / reach * CHART_ROWS
    inside = row - 1 <= place < row + 1 or (row == CHART_ROWS and place >= row)
    return ("o" if check.passed else "x") if inside else " "


def focus_panel(focus: FocusReading, columns: int) -> str:
    """Return how sharp the lens is set beside the best so far, and what to turn."""
    gauge = gauge_text("sharpness", focus.fraction, columns)
    lines = [gauge, "", f"now   {focus.figure:8.2f}", f"best  {focus.best:8.2f}", ""]
    return "\n".join([*lines, hanging(focus.advice, columns, 0), "", "Enter ends."])


def selftest_panel(findings: Sequence[Finding], is_running: bool, columns: int) -> str:
    """Return the findings so far, each with its state."""
    lines = [
        hanging(f"{_state(finding):<5}{finding.part}: {screen_advice(finding.sentence)}", columns, 5)
        for finding in findings
    ]
    if is_running:
        return "\n".join([*lines, "..."])
    failed = sum(finding.state == "failed" for finding in findings)
    return "\n".join([*lines, "", f"{failed} of {len(findings)} failed." if failed else "No part failed."])


def _state(finding: Finding) -> str:
    return {"ok": "ok", "warning": "!", "failed": "FAIL", "skipped": "-"}[finding.state]


def _breakable(fingerprint: str, columns: int) -> str:
    """Return the fingerprint, with a blank to break at if it does not fit on a line."""
    return fingerprint if len(fingerprint) + _LABEL <= columns else fingerprint.replace(":", ": ", 1)


def _labelled(lines: Sequence[tuple[str, str]], columns: int) -> str:
    return "\n".join(hanging(f"{name:<{_LABEL}}{text}", columns, _LABEL) for name, text in lines)


def _network_lines(network: NetworkInfo | None, columns: int) -> list[tuple[str, str]]:
    """Name, addresses and key."""
    if network is None:
        return [("Name", "...")]
    addresses = ", ".join(network.addresses) or "none: connect the cable or join a network"
    return [
        ("Name", network.host_name),
        ("Address", addresses),
        ("Key", _breakable(network.key_fingerprint, columns)),
    ]


def battery_text(state: InstrumentState, *, has_gauge: bool) -> str:
    """Return the supply and battery in words; `has_gauge` as the board profile says."""
    power = state.power
    if power.under_voltage:
        return "the supply voltage is too low: use a stronger supply"
    if power.battery_share is None:
        return "the battery gauge does not answer: run the self-test" if has_gauge else "no battery gauge"
    return percent_text(power.battery_share)


def state_text(state: InstrumentState, columns: int) -> str:
    """Return the most important facts first; what does not fit is cut."""
    parts = [_room(state), _battery(state.power), calibration_text(state.calibration), f"gel {state.gel.gel_id}"]
    if state.processing:
        parts.insert(1, f"{state.processing} processing")
    is_outdated = state.live is not None and state.live.reading.advice == "lights"  # which the screen shows already
    if state.health.level != "good" and state.health.sentence and not is_outdated:
        parts.insert(0, f"! {screen_advice(state.health.sentence)}")
    if state.check.is_due:
        parts.insert(0, "check due: Set-up")
    parts[:0] = [f"! {alarm}" for alarm in state.alarms]
    return shortened(" · ".join(part for part in parts if part), columns)


def calibration_text(calibration: CalibrationState) -> str:
    """Return the age of the active calibration, such as "calibrated 3 h ago"."""
    if calibration.calibration_id is None:
        return "not calibrated"
    if calibration.age_s is None:
        return "calibrated, age unknown"
    old = ", check it" if calibration.is_old else ""
    return f"calibrated {age_text(calibration.age_s)}{old}"


def _room(state: InstrumentState) -> str:
    return "" if state.scans_left is None else f"{_counted(state.scans_left)} left"


def _battery(power: PowerReading) -> str:
    if power.under_voltage:
        return "! supply too low"
    return "" if power.battery_share is None else f"battery {percent_text(power.battery_share)}"


# The panel of the exposure: light on the skin as it is now, and the exposure balance with what it found.

MAX_BAR_COLUMNS: Final = 40
_FULL: Final = 1.0

_MEANING: Final = (
    "Enter balances: a ball is pressed near each light, then exposure and currents use the sensor's range. The active "
    "calibration keeps its own; the next calibration uses the new ones."
)


def exposure_panel(state: InstrumentState, columns: int) -> str:
    """Return the light on the skin, and what an exposure balance is to do, does or has found."""
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
    """Return a bar for each light, and what is saturated."""
    found = state.levels
    if found is None:
        return ["Waiting for the camera."]
    bars = [gauge_text(name[:8], level, columns) for name, level in zip(names, found.median, strict=True)]
    clipped = ", ".join(f"{share:.1%}" for share in found.clipped)
    return ["Light on the skin, of full scale:", *bars, f"saturated pixels: {clipped}"]


def plan_text(plan: CaptureSettings) -> str:
    """Return the exposure and currents in a line."""
    currents = ", ".join(f"{name} {current:.1f}" for name, current in plan.currents_ma.items())
    return f"{plan.settings.exposure_us:.0f} µs; {currents} mA"


def balance_lines(found: ExposureBalance, columns: int) -> list[str]:
    """Return the settings before and after the balance, and what limits it."""
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
