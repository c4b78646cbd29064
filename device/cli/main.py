"""`retroscan`: the handheld's command line.

Exit codes: 0 done, 2 bad input or a refused state, 3 hardware fault, 130 stopped by Ctrl-C.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Final

from cyclopts import App, CycloptsError, Parameter

from device.cli.console import Given, Options, print_error
from device.command_line import (
    BAD_ARGUMENTS,
    Command,
    Folder,
    NewWords,
    add_commands,
    discard_output,
    examples_text,
    in_new_words,
    make_app,
    refused_by_system,
    sentence,
    unknown_command,
    write_any_sign,
)
from device.errors import DeviceError, FrameNotConfirmed, InstrumentBusy
from device.shutdown import signals_as_keyboard_interrupt
from hal.errors import BoardProfileError, HalError, OperatorError
from hal.profile_tables import profile_names

# Every command of `retroscan` with where its function is and examples; nothing of the instrument is imported here.

OLD_COMMANDS: Final = {
    "watch": NewWords(("run",)),
    "shelf": NewWords(("calibrations",)),
    "receive": NewWords(("calibrations", "import-inbox")),
    "import-inbox": NewWords(("calibrations", "import-inbox")),
}
"""Commands of the previous release, still accepted but not listed."""

COMMANDS: Final = (
    Command(
        "tui",
        "device.cli.screens:run_screens",
        "Show the screens on this terminal (the default command).",
        ("retroscan --board twin", "retroscan --board twin tui"),
        listed=False,
    ),
    Command(
        "demo",
        "device.cli.guide:demo",
        "Show the screens on a simulated handheld; key f switches faults on and off.",
        ("retroscan demo",),
    ),
    Command(
        "calibrate",
        "device.cli.instrument_commands:calibrate_guided",
        "Calibrate with guidance: a reference, then ball presses all over the field.",
        ("retroscan calibrate", "retroscan calibrate --auto-exposure --ball-radius-mm 2.5"),
    ),
    Command(
        "scan",
        "device.cli.instrument_commands:scan_once",
        "Wait for one press of the button and scan.",
        (
            "retroscan scan --job J-17 --part housing-3",
            "retroscan scan --capture average",
            "retroscan --board twin scan --object coin --json",
        ),
    ),
    Command(
        "run",
        "device.cli.instrument_commands:run",
        "Scan at every press of the button, without a screen; holding it for six seconds powers off.",
        ("retroscan run", "retroscan run --operator Ada --ball-radius-mm 3"),
    ),
    Command(
        "focus",
        "device.cli.guide:focus",
        "Show how sharp the lens is focused, until Ctrl-C.",
        ("retroscan focus", "retroscan focus --frames 100"),
    ),
    Command(
        "guide",
        "device.cli.guide:guide",
        "Guide back to the spot of an earlier scan, touch by touch.",
        ("retroscan guide --to rg60bb5d63-000007-scan", "retroscan guide --to rg60bb5d63-000007-scan --json"),
    ),
    Command(
        "cover",
        "device.cli.guide:cover",
        "Scan an area larger than the field, press by press, with the way to the next press.",
        ("retroscan cover --width-mm 40 --height-mm 30", "retroscan cover --width-mm 40 --height-mm 30 --part lid"),
    ),
    Command(
        "pair",
        "device.cli.service:pair",
        "Let a workstation pair within two minutes; it shows the same code as this device.",
        ("retroscan pair", "retroscan pair --card /media/card"),
    ),
    Command(
        "gel",
        "device.cli.calibrations:show_or_mount_gel",
        "Show or change the mounted gel; its calibration becomes active.",
        ("retroscan gel", "retroscan gel gel-4 --slab-mm 2.5"),
    ),
    Command(
        "identity",
        "device.cli.service:identity",
        "Print this device's id, created on first use.",
        ("retroscan identity",),
        listed=False,
    ),
    Command(
        "guard-battery",
        "device.cli.service:guard_battery",
        "Power the device off once the battery is nearly empty.",
        ("retroscan guard-battery", "retroscan guard-battery --check"),
        listed=False,
    ),
    Command(
        "status",
        "device.cli.calibrations:show_status",
        "Show calibration, gel and room for scans; opens no hardware.",
        ("retroscan status", "retroscan status --json"),
    ),
    Command(
        "list",
        "device.cli.calibrations:list_scans",
        "List the scans on this device, newest first.",
        ("retroscan list", "retroscan list --json"),
    ),
    Command(
        "selftest",
        "device.cli.instrument_commands:check_parts",
        "Test every part and name the faulty one.",
        ("retroscan selftest --push", "retroscan --board twin selftest --json"),
    ),
    Command(
        "lights-off",
        "device.cli.instrument_commands:lights_off",
        "Switch all lights off.",
        ("retroscan lights-off",),
    ),
)

CALIBRATIONS: Final = (
    Command(
        "use",
        "device.cli.calibrations:use_calibration",
        "Activate a calibration.",
        ("retroscan calibrations use rg60bb5d63-000001-cal",),
    ),
    Command(
        "rollback",
        "device.cli.calibrations:roll_back",
        "Activate the previous version.",
        ("retroscan calibrations rollback",),
    ),
    Command(
        "import",
        "device.cli.calibrations:import_calibration",
        "Copy a calibration folder into the store.",
        ("retroscan calibrations import /media/card/rg60bb5d63-000001-cal --use",),
    ),
    Command(
        "export",
        "device.cli.calibrations:export_calibration",
        "Copy a calibration into a folder.",
        ("retroscan calibrations export rg60bb5d63-000001-cal /media/card",),
    ),
    Command(
        "import-inbox",
        "device.cli.calibrations:import_pushed",
        "Import the calibrations that a workstation pushed.",
        ("retroscan calibrations import-inbox", "retroscan calibrations import-inbox --activate"),
    ),
)
"""Actions of `retroscan calibrations`."""


# Choice of the board profile: `--board`, else the environment, else what the installation wrote.

VARIABLE: Final = "RETROSCAN_BOARD"
BOARD_FILE: Final = Path("/etc/retrograph/board")
DEFAULTS_FILE: Final = Path("/etc/default/retroscan")
"""One line with a name or path; and the environment file of the services, which `board/install.sh` writes."""


def chosen_board(given: str | None, board_file: Path = BOARD_FILE, defaults_file: Path = DEFAULTS_FILE) -> str:
    """Return the board profile's name or path.

    Raises
    ------
    BoardProfileError
        None is named anywhere.
    """
    named = given or os.environ.get(VARIABLE) or _lines(board_file)[0].strip() or _default(defaults_file)
    if named:
        return named
    raise BoardProfileError(
        f"no board is named: give --board NAME, set {VARIABLE}, or write the name into {board_file}; names are "
        f"{', '.join(profile_names())}, or a .toml file"
    )


def _lines(path: Path) -> list[str]:
    """Return the lines of a file, one empty line where it cannot be read."""
    try:
        return path.read_text(encoding="utf-8").split("\n")
    except (OSError, UnicodeDecodeError):
        return [""]


def _default(path: Path) -> str:
    values = [line.split("=", 1)[1].strip() for line in _lines(path) if line.startswith(f"{VARIABLE}=")]
    return values[-1] if values else ""


HARDWARE: Final = 3
SIMULATED_BOARD: Final = "twin"
BOARD_HELP: Final = (
    f"Board profile: one of {', '.join(profile_names())}, or a .toml file; by default {VARIABLE}, {BOARD_FILE} or "
    f"{DEFAULTS_FILE} names it."
)

app = make_app(
    "retroscan",
    "Scan surfaces with a gel at the push of a button. Without a command it opens the screens.",
    "Exit codes: 0 done, 2 bad input or a refused state, 3 hardware fault, 130 stopped by Ctrl-C.",
)
app.usage = "retroscan [OPTIONS] [COMMAND]"
app.meta.suppress_keyboard_interrupt = False
add_commands(app, COMMANDS)
calibrations = App(
    name="calibrations",
    usage="retroscan calibrations [COMMAND] [OPTIONS]",
    help="List calibrations by instrument, gel and lights; use, roll back, import or export one.",
    help_epilogue=examples_text(("retroscan calibrations",)),
)
app.command(calibrations)
add_commands(calibrations, CALIBRATIONS)


@app.default
def screens(*, options: Given) -> int:
    """Show the screens."""
    from device.cli.screens import run_screens

    return run_screens(options=options)


@calibrations.default
def list_calibrations(*, options: Given) -> int:
    """List the calibrations."""
    from device.cli.calibrations import list_calibrations as list_them

    return list_them(options)


@app.meta.default
def launch(
    *words: Annotated[str, Parameter(show=False, allow_leading_hyphen=True)],
    board: Annotated[str | None, Parameter(help=BOARD_HELP)] = None,
    store: Folder | None = None,
) -> int | None:
    """Run the command of the words with the options that stand before it.

    Parameters
    ----------
    store
        Folder of scans and calibrations.
    """
    given_words, notice = in_new_words(words, OLD_COMMANDS)
    words = tuple(given_words)
    if notice is not None:
        print_error(notice)
    elif words and not words[0].startswith("-") and words[0] not in app:
        return _fail(unknown_command(words[0], app), BAD_ARGUMENTS)
    command, given, hidden = app.parse_args(words, exit_on_error=False, print_error=False)
    extra = {}
    if "options" in hidden:
        extra["options"] = Options(chosen_board(board), store)
    elif "simulated" in hidden:
        extra["simulated"] = Options(board or SIMULATED_BOARD, store)
    code: int | None = command(*given.args, **given.kwargs, **extra)
    return code


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code."""
    write_any_sign()
    try:
        with signals_as_keyboard_interrupt(signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT):
            code = app.meta(arguments, exit_on_error=False, print_error=False, result_action="return_value")
        return int(code or 0)
    except CycloptsError as error:
        return _fail(sentence(error, app), BAD_ARGUMENTS)
    except (BoardProfileError, OperatorError) as error:
        return _fail(error, BAD_ARGUMENTS)
    except (HalError, FrameNotConfirmed, InstrumentBusy) as error:
        return _fail(error, HARDWARE)
    except DeviceError as error:
        return _fail(error, BAD_ARGUMENTS)
    except KeyboardInterrupt:
        return _fail("stopped", 130)
    except BrokenPipeError:
        discard_output()
        return 141
    except OSError as error:
        return _fail(refused_by_system(error), BAD_ARGUMENTS)


def _fail(what: object, code: int) -> int:
    print_error(what)
    return code
