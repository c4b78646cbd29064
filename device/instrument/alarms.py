"""Alarms that come before something stops the work: supply, battery, root file system and room for scans."""

from __future__ import annotations

from typing import Final

from hal.interfaces import PowerReading

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
