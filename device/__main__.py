"""`retroscan`: the handheld's command line.

Exit codes: 0 done, 2 bad input or a state that is refused, 3 hardware.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path

from device.active_calibration import read_active
from device.bundle_store import BundleStore
from device.calibration_bundle import CalibrationRecord
from device.ending_signals import ending_like_ctrl_c
from device.errors import DeviceError, FrameNotProven, InstrumentBusy
from device.exposure_levels import Brightness
from device.pairing.commands import add_offload_commands, take_inbox
from device.scan_bundle import Annotations
from device.scanning.balance import balance
from device.scanning.calibrate import calibrate
from device.scanning.instrument_lock import owned_hardware, sole_owner
from device.scanning.mounting import with_mounted_gel
from device.scanning.scanner import Scanner, ScanOutcome
from device.scanning.selftest import selftest
from device.scanning.service_commands import add_service_commands
from device.scanning.supervision import Supervisor
from device.session.commands import add_shelf_commands
from device.session.headless import run_headless
from device.session.instrument import BALL_RADIUS_MM, Instrument
from device.session.service_report import ServiceReport
from device.store_location import default_store
from device.tui.commands import add_screen_command, run_screens
from hal.board_profile import load_board_profile, profile_names
from hal.clock import SystemClock
from hal.errors import BoardProfileError, HalError, OperatorError
from hal.hardware import Hardware, open_hardware
from hal.interfaces import PressObject

DESCRIPTION = "Scan surfaces with a gel at the push of a button."
EXIT_CODES = "exit codes: 0 done, 2 bad input or a state that is refused, 3 hardware, 130 stopped by Ctrl-C"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code."""
    options = _parser().parse_args(arguments)
    command: Callable[[argparse.Namespace], int] = options.command
    try:
        with ending_like_ctrl_c(signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT):
            return command(options)
    except (BoardProfileError, OperatorError) as error:
        return _complain(error, 2)
    except (HalError, FrameNotProven, InstrumentBusy) as error:
        return _complain(error, 3)
    except DeviceError as error:
        return _complain(error, 2)
    except KeyboardInterrupt:
        return _complain("stopped", 130)
    except BrokenPipeError:
        # Whoever read the output has gone: let the interpreter's last flush go nowhere too.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="retroscan", description=DESCRIPTION, epilog=EXIT_CODES)
    parser.add_argument("--version", action="version", version=f"retrograph {version('retrograph')}")
    known = ", ".join(profile_names())
    parser.add_argument("--board", required=True, help=f"board profile: one of {known}, or a .toml file")
    parser.add_argument("--store", type=_folder, help="folder of scans and calibrations")
    parser.set_defaults(command=run_screens)
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", description="without one: the screens")
    add_screen_command(commands)

    guided = commands.add_parser("calibrate", help="guided: a reference, then a ball pressed all over the field")
    _add_ball(guided)
    guided.add_argument("--balance", action="store_true", help="first set exposure and currents for gel and lights")
    guided.set_defaults(command=_calibrate)

    scan = commands.add_parser("scan", help="wait for one press of the button and scan")
    scan.add_argument("--object", default="coin", help="what the twin's operator presses (ignored on a real board)")
    _add_annotations(scan)
    scan.set_defaults(command=_scan)

    watch = commands.add_parser("watch", help="scan at every press of the button, without a screen")
    _add_annotations(watch)
    _add_ball(watch)
    watch.set_defaults(command=_watch)

    add_offload_commands(commands, _folder, _say)
    add_shelf_commands(commands, _folder, _say)
    add_service_commands(commands, _say, _warn)

    test = commands.add_parser("selftest", help="walk through every part and say which one is at fault")
    test.add_argument("--push", action="store_true", help="also wait for a push of the button")
    test.set_defaults(command=_selftest)

    dark = commands.add_parser("lights-off", help="all lights dark")
    dark.set_defaults(command=_lights_off)
    return parser


def _add_annotations(parser: argparse.ArgumentParser) -> None:
    for name in ("job", "part", "operator", "note"):
        parser.add_argument(f"--{name}", type=_text, help="kept with the scan")


def _add_ball(parser: argparse.ArgumentParser) -> None:
    radius = f"radius of the ball to calibrate with, {BALL_RADIUS_MM:g} mm when not given"
    parser.add_argument("--ball-radius-mm", type=_positive, default=BALL_RADIUS_MM, metavar="MM", help=radius)


def _text(text: str) -> str:
    try:
        text.encode()
    except UnicodeEncodeError as error:
        raise argparse.ArgumentTypeError(f"{text!r} is not text in UTF-8") from error
    return text


def _folder(text: str) -> Path:
    if not text:
        raise argparse.ArgumentTypeError("an empty name is no folder")
    return Path(text)


def _positive(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value < 1000.0:
        raise argparse.ArgumentTypeError(f"{text!r} is not a length above 0 mm")
    return value


def _calibrate(options: argparse.Namespace) -> int:
    with owned_hardware(load_board_profile(options.board)) as hardware:
        store = _store(options, hardware)
        plan = balance(hardware, options.ball_radius_mm, _say).plan if options.balance else None
        fitted = with_mounted_gel(hardware, store.root)
        outcome = calibrate(fitted, store, options.ball_radius_mm, _say, plan)
    fit = outcome.fit
    error = "unknown" if fit.held_out_deg is None else f"{fit.held_out_deg:.2f} degrees"
    _say(f"{int(fit.kept.sum())} balls used, {int((~fit.kept).sum())} rejected; error on held-out balls {error}.")
    _say_levels(outcome.bundle.record)
    _say(f"Calibration {outcome.bundle.calibration_id} is active.")
    return 0


def _scan(options: argparse.Namespace) -> int:
    with owned_hardware(load_board_profile(options.board)) as hardware:
        store = _calibrated_store(options, hardware)
        scanner = Scanner(with_mounted_gel(hardware, store.root), store)
        scanner.check_room()
        hardware.operator.ask(PressObject(options.object))
        _say("Press the object into the gel, then push the button.")
        hardware.button.wait_for_push(None)
        _report(scanner.scan(_annotations(options), _cue_lift))
    return 0


def _watch(options: argparse.Namespace) -> int:
    profile = load_board_profile(options.board)
    with sole_owner(profile):
        # Somebody is waited for: the twin's time passes like everybody's.
        hardware = open_hardware(profile, SystemClock())
        store = _store(options, hardware)
        take_inbox(store, _say)
        with Instrument(hardware, store, ball_radius_mm=options.ball_radius_mm) as instrument:
            instrument.set_sticky(_annotations(options))
            report = ServiceReport(Supervisor.from_environment(os.environ), hardware.clock)
            try:
                run_headless(instrument, _say, _warn, lambda: _goes_on(report, instrument))
            finally:
                report.ended()
    return 0


def _goes_on(report: ServiceReport, instrument: Instrument) -> bool:
    report.turn(instrument.state)
    return True


def _selftest(options: argparse.Namespace) -> int:
    failed = 0
    profile = load_board_profile(options.board)
    with sole_owner(profile):
        for finding in selftest(open_hardware(profile), options.push):
            _say(f"{finding.state:8} {finding.part}: {finding.sentence}")
            failed += finding.state == "failed"
    return 3 if failed else 0


def _lights_off(options: argparse.Namespace) -> int:
    with open_hardware(load_board_profile(options.board)).lights as lights:
        lights.dark()
    return 0


def _store(options: argparse.Namespace, hardware: Hardware) -> BundleStore:
    return BundleStore(options.store or default_store(os.environ), hardware.clock)


def _calibrated_store(options: argparse.Namespace, hardware: Hardware) -> BundleStore:
    """A store that can be scanned into; one without a calibration is refused before anything is made."""
    read_active(options.store or default_store(os.environ))
    return _store(options, hardware)


def _annotations(options: argparse.Namespace) -> Annotations:
    return Annotations(job=options.job, part=options.part, operator=options.operator, note=options.note)


def _report(outcome: ScanOutcome) -> None:
    verdict = outcome.bundle.record.verdict
    _say(f"{verdict.level}: {verdict.reason} ({outcome.bundle.scan_id})")
    if outcome.quick_look_fault:
        _say(f"No quick look: {outcome.quick_look_fault}")


def _say_levels(record: CalibrationRecord) -> None:
    """How much of the sensor's range the calibration uses."""
    if found := Brightness.of_figures(record.figures):
        _say(f"Levels: {found.sentence}.")
        if found.warning:
            _say(f"Note: {found.warning}.")


def _say(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def _cue_lift() -> None:
    """Say that the frame is in memory; nobody listening must not cost the scan."""
    with suppress(OSError):
        _say("You may lift.")


def _complain(what: object, code: int) -> int:
    _warn(what)
    return code


def _warn(what: object) -> None:
    sys.stderr.write(f"retroscan: {what}\n")


if __name__ == "__main__":
    sys.exit(main())
