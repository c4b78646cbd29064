"""Commands and options of `retroscan`; nothing of the instrument is imported here, so that help comes at once."""

from __future__ import annotations

import argparse
from importlib.metadata import version
from typing import Final

from device.cli.board import BOARD_FILE, DEFAULTS_FILE, VARIABLE
from device.cli.console import (
    Commands,
    count_argument,
    folder_argument,
    length_mm_argument,
    port_argument,
    text_argument,
)
from device.instrument.calibration_ball import BALL_RADIUS_MM
from hal.board_profile import profile_names

DESCRIPTION = "Scan surfaces with a gel at the push of a button."
EXIT_CODES = "exit codes: 0 done, 2 bad input or a refused state, 3 hardware, 130 stopped by Ctrl-C"

OLD_COMMANDS: Final = {"watch": "run", "shelf": "calibrations", "receive": "import-inbox"}
"""Names of the previous release, still accepted but not listed."""


def make_parser() -> argparse.ArgumentParser:
    """The parser of every command; its options' `command` names a function of this room, "module:function"."""
    parser = argparse.ArgumentParser(prog="retroscan", description=DESCRIPTION, epilog=EXIT_CODES)
    parser.add_argument("--version", action="version", version=f"retrograph {version('retrograph')}")
    known = ", ".join(profile_names())
    named = f"default: {VARIABLE}, {BOARD_FILE} or {DEFAULTS_FILE}"
    parser.add_argument("--board", help=f"board profile: one of {known}, or a .toml file; {named}")
    parser.add_argument("--store", type=folder_argument, help="folder of scans and calibrations")
    parser.set_defaults(command="screens:run_screens")
    commands = parser.add_subparsers(
        title="commands", metavar="COMMAND", dest="command_name", description="default: the screens"
    )
    _add_screen_command(commands)

    guided = commands.add_parser("calibrate", help="guided: a reference, then ball presses all over the field")
    _add_ball(guided)
    exposure = "set exposure and currents for gel and lights first"
    guided.add_argument("--auto-exposure", action="store_true", help=exposure)
    guided.add_argument("--balance", dest="auto_exposure", action="store_true", help=argparse.SUPPRESS)  # its old name
    guided.set_defaults(command="instrument_commands:calibrate_guided")

    scan = commands.add_parser("scan", help="wait for one press of the button and scan")
    scan.add_argument("--object", default="coin", help="what the twin's operator presses (ignored on a real board)")
    _add_annotations(scan)
    _add_json(scan)
    scan.set_defaults(command="instrument_commands:scan_once")

    run = commands.add_parser("run", help="scan at every press of the button, without a screen")
    _add_annotations(run)
    _add_ball(run)
    run.set_defaults(command="instrument_commands:run")

    _add_focus_command(commands)
    _add_pairing_commands(commands)
    _add_calibrations_commands(commands)
    _add_service_commands(commands)
    _add_listing_commands(commands)

    test = commands.add_parser("selftest", help="test every part and name the faulty one")
    test.add_argument("--push", action="store_true", help="also wait for a push of the button")
    _add_json(test)
    test.set_defaults(command="instrument_commands:test_parts")

    dark = commands.add_parser("lights-off", help="switch all lights off")
    dark.set_defaults(command="instrument_commands:lights_off")
    for old, new in OLD_COMMANDS.items():
        commands.choices[old] = commands.choices[new]
    return parser


def _add_annotations(parser: argparse.ArgumentParser) -> None:
    for name in ("job", "part", "operator", "note"):
        parser.add_argument(f"--{name}", type=text_argument, help="stored with the scan")


def _add_json(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--json", action="store_true", help="print one JSON document instead of sentences")


def _add_ball(parser: argparse.ArgumentParser) -> None:
    radius = f"radius of the calibration ball; default: {BALL_RADIUS_MM:g} mm"
    parser.add_argument("--ball-radius-mm", type=length_mm_argument, default=BALL_RADIUS_MM, metavar="MM", help=radius)


def _add_screen_command(commands: Commands[argparse.ArgumentParser]) -> None:
    """Add `tui` to `retroscan`."""
    screens = commands.add_parser("tui", help="show the screens on this terminal (the default command)")
    screens.set_defaults(command="screens:run_screens")


def _add_pairing_commands(commands: Commands[argparse.ArgumentParser]) -> None:
    """Add `pair` and `import-inbox` to `retroscan`."""
    pair = commands.add_parser("pair", help="show a code for two minutes; a workstation that has it may fetch scans")
    pair.add_argument("--port", type=port_argument, help="port that listens for the workstation")
    pair.add_argument("--ssh-port", type=port_argument, default=22, help="port of sshd")
    pair.add_argument("--user", help="account that workstations log in to")
    pair.add_argument("--keys", type=folder_argument, help="folder of authorized keys named in sshd's configuration")
    pair.add_argument("--host-key", type=folder_argument, help="sshd's public key")
    pair.add_argument("--card", type=folder_argument, help="exchange keys through this memory card instead of a code")
    pair.set_defaults(command="pairing:pair")

    inbox = commands.add_parser("import-inbox", help="import the calibrations that a workstation pushed")
    inbox.add_argument("--activate", action="store_true", help="activate the last one imported")
    inbox.set_defaults(command="pairing:import_pushed")


def _add_calibrations_commands(commands: Commands[argparse.ArgumentParser]) -> None:
    """Add `gel` and `calibrations` to `retroscan`."""
    gel = commands.add_parser("gel", help="show or change the mounted gel; its calibration becomes active")
    gel.add_argument("gel_id", nargs="?", help="name of the gel that is mounted now")
    gel.add_argument("--slab-mm", type=float, help="slab thickness of a new gel, mm; default: from the board profile")
    gel.set_defaults(command="calibrations:show_or_mount_gel")

    calibrations = commands.add_parser(
        "calibrations", help="calibrations by instrument, gel and lights: list, use, rollback, import, export"
    )
    actions = calibrations.add_subparsers(title="actions", metavar="ACTION")
    calibrations.set_defaults(command="calibrations:list_calibrations")
    use = actions.add_parser("use", help="activate a calibration")
    use.add_argument("calibration_id", help="its id, as `retroscan calibrations` lists it")
    use.set_defaults(command="calibrations:use_calibration")
    rollback = actions.add_parser("rollback", help="activate the previous version")
    rollback.set_defaults(command="calibrations:roll_back")
    imported = actions.add_parser("import", help="copy a calibration folder into the store")
    imported.add_argument("folder", type=folder_argument, help="the calibration folder")
    imported.add_argument(
        "--slot", choices=("user", "factory"), default="user", help="rollbacks end at the factory calibration"
    )
    imported.add_argument("--adopt", action="store_true", help="accept one made by this instrument under an earlier id")
    imported.add_argument("--use", action="store_true", help="activate it too")
    imported.set_defaults(command="calibrations:import_calibration")
    export = actions.add_parser("export", help="copy a calibration into a folder")
    export.add_argument("calibration_id", help="its id, as `retroscan calibrations` lists it")
    export.add_argument("folder", type=folder_argument, help="destination; the calibration folder is created in it")
    export.set_defaults(command="calibrations:export_calibration")


def _add_service_commands(commands: Commands[argparse.ArgumentParser]) -> None:
    """Add `identity` and `guard-battery` to `retroscan`."""
    identity = commands.add_parser("identity", help="print this device's id, created on first use")
    identity.set_defaults(command="service:identity")

    guard = commands.add_parser("guard-battery", help="power the device off once the battery is nearly empty")
    guard.add_argument("--check", action="store_true", help="only check whether this board measures a battery")
    guard.set_defaults(command="service:guard_battery")


def _add_listing_commands(commands: Commands[argparse.ArgumentParser]) -> None:
    """Add `status` and `list` to `retroscan`."""
    status = commands.add_parser("status", help="calibration, gel, and room for scans; opens no hardware")
    _add_json(status)
    status.set_defaults(command="listing:show_status")
    listing = commands.add_parser("list", help="the scans on this device, newest first")
    _add_json(listing)
    listing.set_defaults(command="listing:list_scans")


def _add_focus_command(commands: Commands[argparse.ArgumentParser]) -> None:
    """Add `focus` to `retroscan`."""
    focus = commands.add_parser("focus", help="show how sharp the lens is set, until Ctrl-C")
    focus.add_argument("--frames", type=count_argument, help="end after that many frames")
    focus.set_defaults(command="focus:focus")
