"""`retroscan identity` and `retroscan guard-battery`: what the units ask of the program beside scanning."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from functools import partial

from device.bundle_store import BundleStore
from device.scanning.battery_guard import NothingToGuard, wait_until_low
from device.scanning.supervision import Supervisor
from device.store_location import default_store
from hal.board_profile import BoardProfile, load_board_profile
from hal.clock import SystemClock
from hal.hardware import open_hardware

Say = Callable[[str], None]


def add_service_commands(
    commands: argparse._SubParsersAction[argparse.ArgumentParser], say: Say, complain: Callable[[object], None]
) -> None:
    """Add the two commands to `retroscan`.

    say : shows one line
    complain : shows what went wrong without ending anything
    """
    identity = commands.add_parser("identity", help="this device's id, drawn when there is none yet")
    identity.set_defaults(command=partial(_identity, say))

    guard = commands.add_parser("guard-battery", help="power the device off once the battery is nearly empty")
    guard.add_argument("--check", action="store_true", help="only say whether this board measures a battery")
    guard.set_defaults(command=partial(_guard_battery, say, complain))


def _identity(say: Say, options: argparse.Namespace) -> int:
    say(BundleStore(options.store or default_store(os.environ), SystemClock()).device_id)
    return 0


def _guard_battery(say: Say, complain: Callable[[object], None], options: argparse.Namespace) -> int:
    profile = load_board_profile(options.board)
    _check_gauge(profile)
    if options.check:
        return 0
    clock = SystemClock()
    with open_hardware(profile, clock).power as power:
        reading = wait_until_low(power, clock, complain)
    share = "unknown" if reading.battery_share is None else f"{reading.battery_share:.0%}"
    say(f"The battery is nearly empty (charge {share}): powering off.")
    if not Supervisor.from_environment(os.environ).power_off():
        complain("nobody powers this device off: do so now, or charge it")
        return 3
    return 0


def _check_gauge(profile: BoardProfile) -> None:
    if "battery" not in profile.capabilities:
        raise NothingToGuard(f"board {profile.name!r} has no battery gauge: nothing to guard")
