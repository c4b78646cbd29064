"""`retroscan` and `retroscan tui`: the screens on this terminal. Only this command needs textual."""

from __future__ import annotations

import argparse
import asyncio
import os
import signal
import sys
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Final

from device.bundle_store import BundleStore
from device.errors import StoreError, TerminalMissing
from device.scanning.instrument_lock import SERVICE_FOLDER, sole_owner
from device.scanning.supervision import Supervisor
from device.session.instrument import Instrument
from device.session.service_report import ServiceReport
from device.store_location import default_store
from device.tui.instrument_thread import InstrumentThread
from device.tui.sheets import ProgramFacts
from device.tui.terminal import colour_depth
from hal.board_profile import load_board_profile
from hal.clock import SystemClock
from hal.errors import DriverMissing
from hal.hardware import open_hardware

if TYPE_CHECKING:
    from device.tui.app import RetroscanApp

POWER_OFF_FILE: Final = "poweroff"
"""What stands in the service's folder for "switch the machine off": its system watches for it."""


def add_screen_command(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command to `retroscan`."""
    screens = commands.add_parser("tui", help="the screens, on this terminal (also what no command means)")
    screens.set_defaults(command=run_screens)


def run_screens(options: argparse.Namespace) -> int:
    """Show the screens until somebody quits; returns the exit code.

    Raises
    ------
    TerminalMissing
        Nobody could see or answer.
    DriverMissing
        textual is not installed.
    DeviceError, HalError
        The store or the board profile cannot be used; what fails later is said on the screens.
    """
    profile = load_board_profile(options.board)
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        raise TerminalMissing("the screens need a terminal for input and error output: use `retroscan watch` without")
    if find_spec("textual") is None:
        raise DriverMissing("textual is not installed: install retrograph[device], or use `retroscan watch`")
    from device.tui.app import RetroscanApp

    depth = colour_depth(os.environ)
    if depth == "mono":
        os.environ["NO_COLOR"] = "1"
    # libcamera's own lines would be written across the screens; "syslog" is the journal where there is one.
    os.environ.setdefault("LIBCAMERA_LOG_FILE", "syslog")
    store_folder = options.store or default_store(os.environ)
    with sole_owner(profile):
        hardware = open_hardware(profile, SystemClock())
        instrument = Instrument(hardware, BundleStore(store_folder, hardware.clock))
        report = ServiceReport(Supervisor.from_environment(os.environ), hardware.clock)
        with InstrumentThread(instrument, report) as thread:
            is_twin = profile.driver == "twin"
            program = ProgramFacts(version("retrograph"), store_folder)
            app = RetroscanApp(instrument, program, depth, profile.sensor, is_twin, lambda: thread.has_ended)
            outcome = asyncio.run(_shown(app))
    if outcome == "off":
        power_off(SERVICE_FOLDER)
    return app.return_code or 0


async def _shown(app: RetroscanApp) -> str | None:
    """What the app returns; a service manager that ends it, and a line that hangs up, quit it in good order."""
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGINT):
        loop.add_signal_handler(number, app.exit)
    try:
        return await app.run_async()
    finally:
        for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGINT):
            loop.remove_signal_handler(number)


def power_off(service_folder: Path) -> None:
    """Ask the system to switch the machine off.

    Raises
    ------
    StoreError
        It was not installed as a handheld, so nobody watches for the request.
    """
    try:
        (service_folder / POWER_OFF_FILE).touch()
    except OSError as error:
        raise StoreError(
            f"{service_folder}: this machine cannot be asked to switch off ({error.strerror}); all is stored and dark: "
            "switch it off by hand"
        ) from error
