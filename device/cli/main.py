"""`retroscan`: the handheld's command line.

Exit codes: 0 done, 2 bad input or a refused state, 3 hardware, 130 stopped by Ctrl-C.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Sequence
from typing import Annotated, Final

from cyclopts import App, CycloptsError, Parameter

from device.cli.board import BOARD_FILE, DEFAULTS_FILE, VARIABLE, chosen_board
from device.cli.commands import CALIBRATIONS, COMMANDS, OLD_COMMANDS
from device.cli.console import Given, Options, print_error
from device.command_line import (
    BAD_ARGUMENTS,
    Folder,
    add_commands,
    examples_text,
    in_new_words,
    make_app,
    sentence,
    unknown_command,
    write_any_sign,
)
from device.errors import DeviceError, FrameNotConfirmed, InstrumentBusy
from device.shutdown import signals_as_keyboard_interrupt
from hal.errors import BoardProfileError, HalError, OperatorError
from hal.profile_files import profile_names

HARDWARE: Final = 3
SIMULATED_BOARD: Final = "twin"
BOARD_HELP: Final = (
    f"Board profile: one of {', '.join(profile_names())}, or a .toml file; by default {VARIABLE}, {BOARD_FILE} or "
    f"{DEFAULTS_FILE} names it."
)

app = make_app(
    "retroscan",
    "Scan surfaces with a gel at the push of a button. Without a command: the screens.",
    "Exit codes: 0 done, 2 bad input or a refused state, 3 hardware, 130 stopped by Ctrl-C.",
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
        # The reader of the output is gone: the interpreter's last flush must not fail either.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141


def _fail(what: object, code: int) -> int:
    print_error(what)
    return code
