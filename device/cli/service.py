"""`retroscan identity`, `guard-battery` and `pair`, and messages to the service manager (systemd)."""

from __future__ import annotations

import os
import select
import socket
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Final, Self

from device.cli.console import Given, Port, open_store, print_error, print_line
from device.command_line import Folder
from device.errors import DeviceError, PairingRefused
from device.instrument.health import EMPTY_FRACTION, NO_ROOM
from device.instrument.state import InstrumentState
from device.pairing import PAIRING_PORT, leave_device_card, take_host_cards
from device.pairing_service import (
    OFFLOAD_USER,
    SSHD_HOST_KEY,
    PairingSetup,
    PairingWindow,
    authorize,
    describe_code,
    how_to_call,
    open_pairing_window,
)
from hal.board_profile import BoardProfile, load_board_profile
from hal.clock import SystemClock
from hal.errors import PowerError
from hal.factory import open_hardware
from hal.interfaces import Clock, Power, PowerReading

BEATS_PER_TIMEOUT: Final = 4
"""Four beats per watchdog timeout leave time for one long scan."""

SEND_TIMEOUT_S: Final = 1.0
"""Send timeout; a message that the service manager does not take in time is dropped, so that work never waits."""

POWER_OFF_FILE: Final = "poweroff"
"""File in the service's folder that asks the system to switch the machine off; a systemd path unit watches for it."""


class SdNotify:
    """The service manager behind a datagram socket.

    Only the work loop feeds the watchdog, so that a hung loop goes silent and is restarted. The loop's owner calls
    `ServiceReport` in every turn and lets no turn wait longer than `longest_wait_s`. The protocol is one datagram of
    text, see sd_notify(3).

    Parameters
    ----------
    address : of the socket, a path or an abstract name that begins with "@"; None without a service manager
    timeout_s : watchdog timeout; None without a watchdog
    folder : where a file named `poweroff` asks for power-off (`systemd/retrograph-poweroff.path`)
    """

    def __init__(self, address: str | None, timeout_s: float | None, folder: Path | None = None) -> None:
        self._address = address
        self._timeout_s = timeout_s if address else None
        self._folder = folder

    @classmethod
    def from_environment(cls, environment: Mapping[str, str]) -> Self:
        """Return the service manager that started this process, from its environment variables."""
        address = environment.get("NOTIFY_SOCKET") or None
        microseconds = environment.get("WATCHDOG_USEC", "")
        is_for_us = environment.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        watches = is_for_us and microseconds.isdecimal() and int(microseconds) > 0
        folder = environment.get("RUNTIME_DIRECTORY")
        return cls(address, int(microseconds) * 1e-6 if watches else None, Path(folder) if folder else None)

    @property
    def longest_wait_s(self) -> float | None:
        """Longest time that one turn of the loop may wait, s; None without a watchdog."""
        return None if self._timeout_s is None else self._timeout_s / BEATS_PER_TIMEOUT

    def ready(self, status: str) -> None:
        """Report that the start is complete."""
        self._send(f"READY=1\nSTATUS={_one_line(status)}\nWATCHDOG=1")

    def status(self, status: str) -> None:
        """Report the present state, as `systemctl status` shows it."""
        self._send(f"STATUS={_one_line(status)}")

    def alive(self) -> None:
        """Feed the watchdog."""
        if self._timeout_s is not None:
            self._send("WATCHDOG=1")

    def stopping(self) -> None:
        """Report that the work loop has ended."""
        self._send("STOPPING=1")

    def power_off(self) -> bool:
        """Ask for an orderly power-off; False if no service handles it."""
        if self._folder is None:
            return False
        try:
            (self._folder / POWER_OFF_FILE).touch()
        except OSError:
            return False
        return True

    def _send(self, message: str) -> None:
        """Send a message; a failure must not cost a scan."""
        if self._address is None:
            return
        address = "\0" + self._address[1:] if self._address.startswith("@") else self._address
        with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as connection:
            connection.settimeout(SEND_TIMEOUT_S)
            connection.connect(address)
            connection.sendall(message.encode())


def _one_line(text: str) -> str:
    return " ".join(text.split())


BROKEN_WAIT_S: Final = 10.0
"""Time for a bus or camera that comes up later than the program."""

BROKEN: Final = "out of order"

EMPTY_MV: Final = 3300.0
"""A lithium cell below this voltage drops fast; the gauge's charge may be wrong, its voltage is not."""

LOW_IN_A_ROW: Final = 3
EVERY_S: Final = 10.0
"""The battery is empty after LOW_IN_A_ROW low readings, one every EVERY_S."""


class ServiceReport:
    """Reports one instrument's state to the service manager: ready, alive, status line.

    After `BROKEN_WAIT_S` an instrument with a broken part is reported as ready, with a status that begins "out of
    order": a failed start would be restarted again and again with a dark screen, whereas a started instrument shows the
    fault on screen and indicator and still hands over its scans. An update that starts so is not kept
    (`board/retrograph-slot confirm`).

    Parameters
    ----------
    notify : connection to the service manager
    clock : the instrument's
    """

    def __init__(self, notify: SdNotify, clock: Clock) -> None:
        self._notify = notify
        self._clock = clock
        self._began_ns = clock.monotonic_ns()
        self._is_ready = False
        self._reported = ""

    def turn(self, state: InstrumentState) -> None:
        """Report the state after one turn of the work loop."""
        now = status_line(state)
        if not self._is_ready and (state.activity != BROKEN or self._waited_s() >= BROKEN_WAIT_S):
            self._is_ready = True
            self._notify.ready(now)
        elif now != self._reported:
            self._notify.status(now)
        self._reported = now
        self._notify.alive()

    def ended(self) -> None:
        """Report that the work loop has ended."""
        self._notify.stopping()

    def _waited_s(self) -> float:
        return (self._clock.monotonic_ns() - self._began_ns) * 1e-9


def status_line(state: InstrumentState) -> str:
    """Return one line on the instrument's state; a reason why it cannot scan comes first, then every alarm."""
    if state.activity == BROKEN:
        line = f"{BROKEN}: {state.sentence}"
    elif state.calibration.fault:
        line = f"no scans yet: {state.calibration.fault}"
    elif state.scans_left == 0:
        line = f"no scans: {state.alarms[0] if state.alarms else NO_ROOM}"
    else:
        line = "ready" if state.scans_left is None else f"ready: room for {state.scans_left} scans"
    return "; ".join([line, *(alarm for alarm in state.alarms if alarm not in line)])


def identity(*, options: Given) -> int:
    """Print this device's id, created on first use."""
    print_line(open_store(options).device_id)
    return 0


def guard_battery(*, check: bool = False, options: Given) -> int:
    """Power the device off once the battery is nearly empty.

    Parameters
    ----------
    check
        Only check whether this board measures a battery.
    """
    profile = load_board_profile(options.board)
    _check_gauge(profile)
    if check:
        return 0
    clock = SystemClock()
    with open_hardware(profile, clock).power as power:
        reading = wait_until_low(power, clock, print_error)
    charge = "unknown" if reading.battery_share is None else f"{reading.battery_share:.0%}"
    print_line(f"The battery is nearly empty (charge {charge}): powering off.")
    if not SdNotify.from_environment(os.environ).power_off():
        print_error("no service can power this device off: switch it off now, or charge it")
        return 3
    return 0


def _check_gauge(profile: BoardProfile) -> None:
    if "battery" not in profile.capabilities:
        raise NoBattery(f"board {profile.name!r} has no battery gauge: no battery to monitor")


class NoBattery(DeviceError, LookupError):
    """The board measures no battery. Disable the battery guard, or wire a gauge and add it to the board profile."""


def is_low(reading: PowerReading) -> bool:
    """Return whether a reading shows an empty battery; unmeasured values are ignored."""
    low_charge = reading.battery_share is not None and reading.battery_share <= EMPTY_FRACTION
    low_voltage = reading.battery_mv is not None and reading.battery_mv <= EMPTY_MV
    return low_charge or low_voltage


def wait_until_low(power: Power, clock: Clock, print_error: Callable[[object], None]) -> PowerReading:
    """Block until the battery was low in `LOW_IN_A_ROW` consecutive readings; returns the last one.

    A failed reading is printed and skipped.
    """
    low = 0
    while True:
        try:
            reading = power.read()
        except PowerError as error:
            print_error(error)
        else:
            low = low + 1 if is_low(reading) else 0
            if low >= LOW_IN_A_ROW:
                return reading
        clock.sleep(EVERY_S)


POLL_S: Final = 0.2


def pair(
    *,
    port: Port = PAIRING_PORT,
    ssh_port: Port = 22,
    user: str = OFFLOAD_USER,
    keys: Folder | None = None,
    host_key: Folder = SSHD_HOST_KEY,
    card: Folder | None = None,
    options: Given,
) -> int:
    """Let a workstation pair within two minutes; it shows the same code as this device.

    Parameters
    ----------
    port
        Port that listens for the workstation.
    ssh_port
        Port of sshd.
    user
        Account that workstations log in to.
    keys
        Folder of authorized keys named in sshd's configuration.
    host_key
        sshd's public key.
    card
        Exchange keys through this memory card instead of the network.
    """
    store = open_store(options)
    setup = PairingSetup(port, ssh_port, user, host_key, keys)
    if card:
        own, hosts = setup.card(store), take_host_cards(card)
        for host in hosts:
            authorize(setup.authorized_keys(store), host)
        left = leave_device_card(card, own)
        print_line(f"{len(hosts)} workstations authorized; this device's card is {left}")
        return 0
    with open_pairing_window(store, SystemClock(), setup) as window:
        print_line(how_to_call(window, setup, store))
        _confirm_codes(window)
        print_line(f"Paired with {window.wait().name}.")
    return 0


def _confirm_codes(window: PairingWindow) -> None:
    """Print each code, and confirm it when its digits are typed, until the window is closed."""
    printed = None
    while window.outcome is None:
        shown = window.shown
        if shown is not None and shown is not printed:
            print_line(describe_code(shown, "type the code here"))
        printed = shown
        if select.select([sys.stdin], [], [], POLL_S)[0]:
            line = sys.stdin.readline()
            if not line:
                raise PairingRefused("nobody can confirm a code here: run this in a terminal, or hold the button")
            if shown is not None and "".join(line.split()) == "".join(shown.code.split()):
                window.confirm(shown.code)
            else:
                print_line("That is not the code: nothing is confirmed.")
