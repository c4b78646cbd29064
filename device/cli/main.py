"""`retroscan`: the handheld's command line.

Exit codes: 0 done, 2 bad input or a refused state, 3 hardware.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib.metadata import version
from typing import Final

from device.acquisition.auto_exposure import auto_exposure
from device.acquisition.calibrate import calibrate
from device.acquisition.gel_profile import with_active_gel
from device.acquisition.instrument_lock import exclusive_instrument, open_exclusive
from device.acquisition.scanner import Scanner, ScanOutcome
from device.acquisition.sd_notify import SdNotify
from device.acquisition.selftest import selftest
from device.bundles.calibration import CalibrationRecord
from device.bundles.scan import Annotations
from device.cli.calibrations import add_calibrations_commands
from device.cli.console import (
    folder_argument,
    length_mm_argument,
    open_store,
    print_error,
    print_line,
    store_folder,
    text_argument,
)
from device.cli.focus import add_focus_command
from device.cli.headless import run_headless
from device.cli.pairing import add_pairing_commands, import_inbox
from device.cli.screens import add_screen_command, run_screens
from device.cli.service import ServiceReport, add_service_commands
from device.errors import DeviceError, FrameNotConfirmed, InstrumentBusy
from device.imaging.exposure import Brightness
from device.instrument.instrument import BALL_RADIUS_MM, Instrument
from device.shutdown import signals_as_keyboard_interrupt
from device.store.active import read_active
from hal.board_profile import load_board_profile, profile_names
from hal.clock import SystemClock
from hal.errors import BoardProfileError, HalError, OperatorError
from hal.factory import open_hardware
from hal.interfaces import PressObject

DESCRIPTION = "Scan surfaces with a gel at the push of a button."
EXIT_CODES = "exit codes: 0 done, 2 bad input or a refused state, 3 hardware, 130 stopped by Ctrl-C"


OLD_COMMANDS: Final = {"watch": "run", "shelf": "calibrations", "receive": "import-inbox"}
"""Names of the previous release, still accepted but not listed."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code."""
    options = _parser().parse_args(arguments)
    if new_name := OLD_COMMANDS.get(options.command_name):
        print_error(f"`{options.command_name}` is now called `{new_name}`; the old name will be removed")
    command: Callable[[argparse.Namespace], int] = options.command
    try:
        with signals_as_keyboard_interrupt(signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT):
            return command(options)
    except (BoardProfileError, OperatorError) as error:
        return _fail(error, 2)
    except (HalError, FrameNotConfirmed, InstrumentBusy) as error:
        return _fail(error, 3)
    except DeviceError as error:
        return _fail(error, 2)
    except KeyboardInterrupt:
        return _fail("stopped", 130)
    except BrokenPipeError:
        # The reader of the output is gone: the interpreter's last flush must not fail either.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="retroscan", description=DESCRIPTION, epilog=EXIT_CODES)
    parser.add_argument("--version", action="version", version=f"retrograph {version('retrograph')}")
    known = ", ".join(profile_names())
    parser.add_argument("--board", required=True, help=f"board profile: one of {known}, or a .toml file")
    parser.add_argument("--store", type=folder_argument, help="folder of scans and calibrations")
    parser.set_defaults(command=run_screens)
    commands = parser.add_subparsers(
        title="commands", metavar="COMMAND", dest="command_name", description="default: the screens"
    )
    add_screen_command(commands)

    guided = commands.add_parser("calibrate", help="guided: a reference, then ball presses all over the field")
    _add_ball(guided)
    exposure = "set exposure and currents for gel and lights first"
    guided.add_argument("--auto-exposure", action="store_true", help=exposure)
    guided.add_argument("--balance", dest="auto_exposure", action="store_true", help=argparse.SUPPRESS)  # its old name
    guided.set_defaults(command=_calibrate)

    scan = commands.add_parser("scan", help="wait for one press of the button and scan")
    scan.add_argument("--object", default="coin", help="what the twin's operator presses (ignored on a real board)")
    _add_annotations(scan)
    scan.set_defaults(command=_scan)

    run = commands.add_parser("run", help="scan at every press of the button, without a screen")
    _add_annotations(run)
    _add_ball(run)
    run.set_defaults(command=_run)

    add_focus_command(commands)
    add_pairing_commands(commands)
    add_calibrations_commands(commands)
    add_service_commands(commands)

    test = commands.add_parser("selftest", help="test every part and name the faulty one")
    test.add_argument("--push", action="store_true", help="also wait for a push of the button")
    test.set_defaults(command=_selftest)

    dark = commands.add_parser("lights-off", help="switch all lights off")
    dark.set_defaults(command=_lights_off)
    for old, new in OLD_COMMANDS.items():
        commands.choices[old] = commands.choices[new]
    return parser


def _add_annotations(parser: argparse.ArgumentParser) -> None:
    for name in ("job", "part", "operator", "note"):
        parser.add_argument(f"--{name}", type=text_argument, help="stored with the scan")


def _add_ball(parser: argparse.ArgumentParser) -> None:
    radius = f"radius of the calibration ball; default: {BALL_RADIUS_MM:g} mm"
    parser.add_argument("--ball-radius-mm", type=length_mm_argument, default=BALL_RADIUS_MM, metavar="MM", help=radius)


def _calibrate(options: argparse.Namespace) -> int:
    with open_exclusive(load_board_profile(options.board)) as hardware:
        store = open_store(options, hardware.clock)
        plan = auto_exposure(hardware, options.ball_radius_mm, print_line).plan if options.auto_exposure else None
        fitted = with_active_gel(hardware, store.root)
        outcome = calibrate(fitted, store, options.ball_radius_mm, print_line, plan)
    fit = outcome.fit
    error = "unknown" if fit.held_out_deg is None else f"{fit.held_out_deg:.2f} degrees"
    print_line(f"{int(fit.kept.sum())} balls used, {int((~fit.kept).sum())} rejected; error on held-out balls {error}.")
    _print_levels(outcome.bundle.record)
    print_line(f"Calibration {outcome.bundle.calibration_id} is active.")
    return 0


def _scan(options: argparse.Namespace) -> int:
    with open_exclusive(load_board_profile(options.board)) as hardware:
        read_active(store_folder(options))  # a store without a calibration is refused before anything is created
        store = open_store(options, hardware.clock)
        scanner = Scanner(with_active_gel(hardware, store.root), store)
        scanner.check_room()
        hardware.operator.ask(PressObject(options.object))
        print_line("Press the object into the gel, then push the button.")
        hardware.button.wait_for_push(None)
        _report(scanner.scan(_annotations(options), _cue_lift))
    return 0


def _run(options: argparse.Namespace) -> int:
    profile = load_board_profile(options.board)
    with exclusive_instrument(profile):
        # The loop waits for a person: the twin runs in real time too.
        hardware = open_hardware(profile, SystemClock())
        store = open_store(options, hardware.clock)
        import_inbox(store)
        with Instrument(hardware, store, ball_radius_mm=options.ball_radius_mm) as instrument:
            instrument.set_sticky(_annotations(options))
            report = ServiceReport(SdNotify.from_environment(os.environ), hardware.clock)
            try:
                run_headless(instrument, print_line, print_error, lambda: _goes_on(report, instrument))
            finally:
                report.ended()
    return 0


def _goes_on(report: ServiceReport, instrument: Instrument) -> bool:
    report.turn(instrument.state)
    return True


def _selftest(options: argparse.Namespace) -> int:
    failed = 0
    profile = load_board_profile(options.board)
    with exclusive_instrument(profile):
        for finding in selftest(open_hardware(profile), options.push):
            print_line(f"{finding.state:8} {finding.part}: {finding.sentence}")
            failed += finding.state == "failed"
    return 3 if failed else 0


def _lights_off(options: argparse.Namespace) -> int:
    with open_hardware(load_board_profile(options.board)).lights as lights:
        lights.off()
    return 0


def _annotations(options: argparse.Namespace) -> Annotations:
    return Annotations(job=options.job, part=options.part, operator=options.operator, note=options.note)


def _report(outcome: ScanOutcome) -> None:
    verdict = outcome.bundle.record.verdict
    print_line(f"{verdict.level}: {verdict.reason} ({outcome.bundle.scan_id})")
    if outcome.quick_look_fault:
        print_line(f"No quick look: {outcome.quick_look_fault}")


def _print_levels(record: CalibrationRecord) -> None:
    """Print how much of the sensor's range the calibration uses."""
    if found := Brightness.of_figures(record.figures):
        print_line(f"Levels: {found.sentence}.")
        if found.warning:
            print_line(f"Note: {found.warning}.")


def _cue_lift() -> None:
    """Print that the object may be lifted; a closed output must not cost the scan."""
    with suppress(OSError):
        print_line("You may lift.")


def _fail(what: object, code: int) -> int:
    print_error(what)
    return code
