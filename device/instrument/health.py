"""Health of lights, skin and gel: baseline checks, alarms, and the figures that the front end shows."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Executor, Future
from typing import Final

from device.acquisition.scan_health import ScanHealth, ZeroCheck
from device.instrument.live import LiveFrame
from device.instrument.state import GelState, HealthState
from device.quality.press_faults import FLAT_RESIDUAL_UM, GEL_PRESSES, MAX_DEFECTS, MOVING, STALE_EVIDENCE_SCANS
from device.quality.verdict import dirt_sentence, drift_complaints
from hal.interfaces import PowerReading

CALM_FRAMES: Final = 5

REQUESTED_INTERVAL_S: Final = 0.3

AWAITED_INTERVAL_S: Final = 1.0

IDLE_INTERVAL_S: Final = 10.0


def health_state(health: ScanHealth, gel: GelState, zero: ZeroCheck | None) -> HealthState:
    """Return the present health, with the first complaint.

    zero : the last zero check under this calibration
    """
    complaints = list(_complaints(health, gel, zero))
    return HealthState(
        light_change=health.light_change,
        scans_unseen=health.unseen_scans,
        reference_change=health.reference_change,
        defect_fraction=health.defect_fraction,
        flat_residual_um=zero.flat_residual_um if zero else None,
        level="doubtful" if complaints else "good",
        sentence=complaints[0] if complaints else _summary(health),
    )


def zero_sentence(zero: ZeroCheck) -> str:
    """Return the result of a zero check in words."""
    if zero.flat_residual_um <= FLAT_RESIDUAL_UM:
        return f"Zero check passed: untouched skin reads flat to {zero.flat_residual_um:.1f} µm."
    return (
        f"Zero check failed: untouched skin reads flat to only {zero.flat_residual_um:.1f} µm, "
        f"{FLAT_RESIDUAL_UM:g} µm are allowed. Touch nothing, wipe the gel; if it fails again, calibrate."
    )


def _complaints(health: ScanHealth, gel: GelState, zero: ZeroCheck | None) -> Iterator[str]:
    for _, reason in drift_complaints(health.light_change, health.reference_change):
        yield reason
    if health.defect_fraction > MAX_DEFECTS:
        yield dirt_sentence(health.defect_fraction)
    if zero and zero.flat_residual_um > FLAT_RESIDUAL_UM:
        yield zero_sentence(zero)
    if health.unseen_scans > STALE_EVIDENCE_SCANS:
        yield f"untouched skin was not seen for {health.unseen_scans} scans: lift off, or run a zero check"
    if gel.presses > GEL_PRESSES:
        yield f"gel {gel.gel_id} was pressed {gel.presses} times: inspect its coat"


def _summary(health: ScanHealth) -> str:
    changes = [abs(change) for change in health.light_change.values() if change is not None]
    if not changes:
        return "Lights not measured yet: touch nothing for a moment."
    return f"Lights within {max(changes):.1%} of calibration."


class BaselineScheduler:
    """Schedules baseline checks of untouched skin: 0.3 s after a press once the view is calm, then every 10 s.

    Contact that comes or goes is checked once it is calm, since a light that changes looks like contact.
    Until the lights were measured alone, every movement in view requests an attempt, since it may be the lift of an
    object that was in contact from the start, and so does every second of a press that waits for its verdict.
    """

    def __init__(self, health: ScanHealth, executor: Executor) -> None:
        self._health = health
        self._executor = executor
        self._check: Future[bool] | None = None
        self._calm_frames = 0
        self._is_requested = True
        self._checked_ns = 0
        self._was_in_air = True

    def request(self) -> None:
        """Request a check soon, after a press."""
        self._is_requested = True

    def step(self, live: LiveFrame) -> bool:
        """Start a check if one is due; returns whether a finished one updated the lights."""
        updated = False
        if self._check and self._check.done():
            updated = self._check.result()
            self._is_requested = self._is_requested and not updated
            self._check = None
        motion, in_air = live.reading.motion, live.reading.in_air
        is_calm = motion is not None and motion < MOVING
        self._calm_frames = self._calm_frames + 1 if is_calm else 0
        has_changed = in_air != self._was_in_air
        if has_changed:
            self._checked_ns = 0
        if not self._health.knows_shares and (not is_calm or has_changed):
            self._is_requested = True
        self._was_in_air = in_air
        if self._check is None and self._health.knows_shares and self._is_due(live):
            self._checked_ns = live.frame.sensor_timestamp_ns
            self._check = self._executor.submit(self._health.update, live.frame)
        return updated

    def wants_lights_alone(self, live: LiveFrame, *, is_awaited: bool) -> bool:
        """Return whether each light should now be measured alone, which the first check needs; asked once per attempt.

        is_awaited : whether a press waits for it
        """
        if self._health.knows_shares or not self._is_due(live, AWAITED_INTERVAL_S if is_awaited else IDLE_INTERVAL_S):
            return False
        self._checked_ns = live.frame.sensor_timestamp_ns
        return True

    def _is_due(self, live: LiveFrame, otherwise_s: float = IDLE_INTERVAL_S) -> bool:
        wait_s = REQUESTED_INTERVAL_S if self._is_requested else otherwise_s
        waited_ns = live.frame.sensor_timestamp_ns - self._checked_ns
        return self._calm_frames >= CALM_FRAMES and waited_ns >= wait_s * 1e9

    def measured_alone(self, succeeded: bool) -> None:
        """Each light was measured alone: check soon if that succeeded, else after the next movement."""
        self._is_requested = succeeded
        self._calm_frames = 0


# Alarms that come before something stops the work: supply, battery, root file system and room for scans.

BATTERY_ALARMS: Final = (
    (0.05, "battery at {charge:.0%}: the instrument switches itself off"),
    (0.10, "battery at {charge:.0%}: charge it now"),
    (0.20, "battery at {charge:.0%}: charge it soon"),
)
"""Alarms from a charge downwards, worst first."""

EMPTY_FRACTION: Final = 0.05
EMPTY_READINGS: Final = 3
"""The instrument stops in order after so many readings in a row at or below this charge."""

LOW_ROOM_SCANS: Final = 50
NO_ROOM: Final = "no room for another scan: offload scans, or free space"


def alarms(power: PowerReading, scans_left: int | None, root: str | None = None) -> tuple[str, ...]:
    """Return every alarm, one sentence each, most urgent first; None and unmeasured values raise none.

    root : what is wrong with the root file system (`device.acquisition.selftest`)
    """
    found = []
    charge = power.battery_share
    if power.under_voltage:
        found.append("the supply voltage is too low: use a stronger supply")
    if charge is not None:
        found += [text.format(charge=charge) for limit, text in BATTERY_ALARMS if charge <= limit][:1]
    if root:
        found.append(root)
    if scans_left == 0:
        found.append(NO_ROOM)
    elif scans_left is not None and scans_left <= LOW_ROOM_SCANS:
        found.append(f"room for {scans_left} more scans: offload soon")
    return tuple(found)


def alarm_kinds(found: tuple[str, ...]) -> frozenset[str]:
    """Return what the alarms are about, without their numbers: an alarm is announced once, not with every per cent."""
    return frozenset("".join(letter for letter in sentence if not letter.isdigit()) for sentence in found)
