"""`retrosync`: the workstation's command line.

Exit codes: 0 done, 1 partly done (failures are named), 2 bad input, 3 connection, 130 stopped.
"""

from __future__ import annotations

import gc
import os
import signal
import sys
from collections.abc import Callable, Sequence
from typing import Final

from cyclopts import CycloptsError

from device.command_line import add_commands, in_new_words, make_app, sentence, write_any_sign
from device.errors import DeviceError
from device.shutdown import signals_as_keyboard_interrupt
from host_sync.cli.commands import COMMANDS, OLD_COMMANDS
from host_sync.cli.console import BAD_INPUT, CONNECTION, DONE, PARTLY, print_error, tell_compile_time
from host_sync.errors import HostError, SourceError

SEARCH_EVERY: Final = 400_000
"""Objects between two searches: more than the libraries make while they are loaded.

By Python's own number, 700, a second `retrosync reconstruct` searches 380 times, 0.13 of its processor seconds; by half
this number once, 0.06.
"""


def search_seldom() -> None:
    """Search for unreachable cycles every `SEARCH_EVERY` objects from now on."""
    gc.set_threshold(SEARCH_EVERY)


app = make_app(
    "retrosync",
    "Fetch scans from a handheld, verify them, reconstruct, measure and show their surfaces.",
    "Exit codes: 0 done, 1 partly done (failures are named), 2 bad input, 3 connection, 130 stopped.",
)
add_commands(app, COMMANDS)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command that the arguments name; returns the exit code."""
    write_any_sign()
    search_seldom()
    # Matrices are small: a library's own threads cost more than they gain, several times as much on a busy machine.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    return run(lambda: _call(sys.argv[1:] if arguments is None else arguments))


def _call(arguments: Sequence[str]) -> int | None:
    """Call the command, by its words of this release."""
    words, notice = in_new_words(arguments, OLD_COMMANDS)
    if notice is not None:
        print_error(notice, DONE)
    result: int | None = app(words, exit_on_error=False, print_error=False, result_action="return_value")
    return result


def run(command: Callable[[], int | None]) -> int:
    """Run a command; returns its exit code, or that of the error that ended it, which is printed as one sentence."""
    try:
        with signals_as_keyboard_interrupt(signal.SIGTERM):
            result = command()
        sys.stdout.flush()
        tell_compile_time()
    except SourceError as error:
        return print_error(error, CONNECTION)
    except (DeviceError, HostError) as error:
        return print_error(error, BAD_INPUT)
    except CycloptsError as error:
        return print_error(sentence(error, app), BAD_INPUT)
    except KeyboardInterrupt:
        return print_error("stopped: unfinished results are not kept", 130)
    except BrokenPipeError:
        _discard_output()
        return 141
    except OSError as error:
        _discard_output()
        return print_error(f"the output cannot be written ({error.strerror or error}): redirect it elsewhere", PARTLY)
    return int(result or DONE)


def _discard_output() -> None:
    """Send the interpreter's last flush nowhere: the reader of the output has gone, or it is full."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
