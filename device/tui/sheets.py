"""The sheets of the set-up screen: what is known of the instrument, its lights and gel, its network and its store."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from device.scanning.selftest import Finding
from device.session.network import NetworkFacts
from device.session.state import CalibrationState, HealthState, InstrumentState, PairingState
from device.tui.state_line import calibration_text
from device.tui.words import hanging, share_text

_LABEL: Final = 12


@dataclass(frozen=True, slots=True)
class ProgramFacts:
    """What does not change while the program runs: its version, and the folder of its scans."""

    version: str
    store: Path


def instrument_sheet(state: InstrumentState, program: ProgramFacts, network: NetworkFacts | None, columns: int) -> str:
    """Everything that one reads out on the telephone."""
    calibration, gel = state.calibration, state.gel
    error = "" if calibration.held_out_deg is None else f", error {calibration.held_out_deg:.1f} degrees"
    left = "unknown" if state.scans_left is None else f"{state.scans_left} more fit"
    stored = "" if state.scans_stored is None else f"{state.scans_stored} scans, "
    lines = [
        ("Device", f"{state.device_id} ({state.board})"),
        *_network_lines(network, columns),
        ("Gel", f"{gel.gel_id}, {gel.slab_thickness_mm:g} mm, pressed {gel.presses} times"),
        ("Skin", skin_text(state.health)),
        ("Calibration", calibration.fault or f"{calibration_text(calibration)}{_version(calibration)}{error}"),
        *_brightness_lines(calibration),
        ("Lights", lights_text(state.health)),
        ("Power", battery_text(state)),
        ("Storage", f"{stored}{left}"),
        ("Folder", str(program.store)),
        ("Version", program.version),
    ]
    return _labelled(lines, columns)


def _version(calibration: CalibrationState) -> str:
    return "" if calibration.version is None else f", version {calibration.version} ({calibration.slot})"


def _brightness_lines(calibration: CalibrationState) -> list[tuple[str, str]]:
    """How much of the sensor's range the calibration uses, where it says so."""
    found = calibration.brightness
    return [] if found is None else [("Brightness", found.warning or found.sentence)]


def lights_text(health: HealthState) -> str:
    """How far each light has changed since calibration."""
    seen = [f"{name} {change:+.1%}" for name, change in health.light_change.items() if change is not None]
    if not seen:
        return "not looked at yet: lift off, so that untouched skin is seen"
    return f"{', '.join(seen)} since calibration"


def skin_text(health: HealthState) -> str:
    """Defects of the resting skin, and how flat the last zero check read."""
    defects = "not looked at yet" if health.defect_share is None else f"{health.defect_share:.1%} under defects"
    return defects if health.flat_residual_um is None else f"{defects}, flat to {health.flat_residual_um:.1f} µm"


def pairing_sheet(pairing: PairingState, network: NetworkFacts | None, now_ns: int, columns: int) -> str:
    """How to pair while the window is open, the code in large; afterwards what came of it."""
    if not pairing.is_open:
        return hanging(pairing.sentence, columns, 0)
    half = len(pairing.code) // 2
    code = "   ".join(" ".join(part) for part in (pairing.code[:half], pairing.code[half:]))
    left_s = max(round((pairing.open_until_ns - now_ns) * 1e-9), 0)
    host = network.host_name if network else "this-instrument"
    lines = ["On the workstation:", f"  retrosync pair {host}.local", "", f"  Code    {code}", "", f"{left_s} s left."]
    return "\n".join([*lines, "", _labelled(_network_lines(network, columns), columns)])


def selftest_sheet(findings: Sequence[Finding], is_running: bool, columns: int) -> str:
    """The findings so far, each with a word for its state."""
    lines = [hanging(f"{_state(finding):<5}{finding.part}: {finding.sentence}", columns, 5) for finding in findings]
    if is_running:
        return "\n".join([*lines, "..."])
    failed = sum(finding.state == "failed" for finding in findings)
    return "\n".join([*lines, "", f"{failed} of {len(findings)} failed." if failed else "All is well."])


def _state(finding: Finding) -> str:
    return {"ok": "ok", "warning": "!", "failed": "FAIL", "skipped": "-"}[finding.state]


def _breakable(fingerprint: str, columns: int) -> str:
    """The fingerprint, in two pieces where there is no room for one."""
    return fingerprint if len(fingerprint) + _LABEL <= columns else fingerprint.replace(":", ": ", 1)


def _labelled(lines: Sequence[tuple[str, str]], columns: int) -> str:
    return "\n".join(hanging(f"{name:<{_LABEL}}{text}", columns, _LABEL) for name, text in lines)


def _network_lines(network: NetworkFacts | None, columns: int) -> list[tuple[str, str]]:
    """Name, addresses and key."""
    if network is None:
        return [("Name", "...")]
    addresses = ", ".join(network.addresses) or "none: connect the cable or join a network"
    return [
        ("Name", network.host_name),
        ("Address", addresses),
        ("Key", _breakable(network.key_fingerprint, columns)),
    ]


def battery_text(state: InstrumentState) -> str:
    """Supply and battery in words."""
    power = state.power
    if power.under_voltage:
        return "the supply is too low: use a stronger one"
    return "no battery gauge" if power.battery_share is None else share_text(power.battery_share)
