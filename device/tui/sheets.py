"""The sheets of the set-up screen: what is known of the instrument, its lights and gel, its network and its store."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from device.scanning.selftest import Finding
from device.session.state import HealthState, InstrumentState, PairingState
from device.tui.state_line import calibration_text
from device.tui.words import hanging, share_text

_LABEL: Final = 12
_PAIRING: Final = "A workstation that knows the code may fetch scans from now on.\nEnter shows a code for two minutes."
_SELFTEST: Final = (
    "Every part is tried, and each light is looked at through the camera.\nTouch nothing with the gel. Enter starts."
)


@dataclass(frozen=True, slots=True)
class MachineFacts:
    """What the machine says of itself, read once.

    addresses : interface and IPv4 address
    fingerprint : of sshd's key, or why there is none
    """

    host: str
    addresses: tuple[tuple[str, str], ...]
    fingerprint: str
    store: str
    version: str


def instrument_sheet(state: InstrumentState, machine: MachineFacts, columns: int) -> str:
    """Everything that one reads out on the telephone."""
    calibration, gel = state.calibration, state.gel
    error = "" if calibration.held_out_deg is None else f", error {calibration.held_out_deg:.1f} degrees"
    left = "unknown" if state.scans_left is None else f"{state.scans_left} more fit"
    stored = "" if state.scans_stored is None else f"{state.scans_stored} scans, "
    lines = [
        ("Device", f"{state.device_id} ({state.board})"),
        ("Name", machine.host),
        *_address_lines(machine),
        ("Key", _breakable(machine.fingerprint, columns)),
        ("Gel", f"{gel.gel_id}, {gel.slab_thickness_mm:g} mm, pressed {gel.presses} times"),
        ("Calibration", calibration.fault or f"{calibration_text(calibration)}{error}"),
        ("Lights", lights_text(state.health)),
        ("Storage", f"{stored}{left}"),
        ("Folder", machine.store),
        ("Version", machine.version),
    ]
    return _labelled(lines, columns)


def lights_text(health: HealthState) -> str:
    """How far each light has changed since calibration."""
    seen = [f"{name} {change:+.1%}" for name, change in health.light_change.items() if change is not None]
    if not seen:
        return "not looked at yet: lift off, so that untouched skin is seen"
    return f"{', '.join(seen)} since calibration"


def pairing_sheet(pairing: PairingState | None, machine: MachineFacts, now_ns: int, columns: int) -> str:
    """How to pair; while the window is open, the code in large."""
    if pairing is None or not pairing.is_open:
        ended = f"\n\n{pairing.sentence}" if pairing and pairing.sentence else ""
        return f"{_PAIRING}{ended}"
    half = len(pairing.code) // 2
    code = "   ".join(" ".join(part) for part in (pairing.code[:half], pairing.code[half:]))
    left_s = max(round((pairing.open_until_ns - now_ns) * 1e-9), 0)
    lines = [
        "On the workstation:",
        f"  retrosync pair {machine.host}",
        "",
        f"  Code    {code}",
        "",
        f"{left_s} s left. The workstation shows this key:",
        f"  {machine.fingerprint}",
        "",
        _labelled(_address_lines(machine), columns),
    ]
    return "\n".join(lines)


def selftest_sheet(findings: Sequence[Finding], is_running: bool, columns: int) -> str:
    """The findings so far, each with a word for its state."""
    if not findings and not is_running:
        return _SELFTEST
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


def _address_lines(machine: MachineFacts) -> list[tuple[str, str]]:
    """Interfaces and addresses, the first with the label."""
    if not machine.addresses:
        return [("Address", "none: connect the cable or join a network")]
    texts = [f"{address} ({interface})" for interface, address in machine.addresses]
    return [("Address" if number == 0 else "", text) for number, text in enumerate(texts)]


def battery_text(state: InstrumentState) -> str:
    """Supply and battery in words."""
    power = state.power
    if power.under_voltage:
        return "the supply is too low: use a stronger one"
    return "no battery gauge" if power.battery_share is None else share_text(power.battery_share)
