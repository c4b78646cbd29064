"""`retroscan`: the handheld's command line.

Exit codes: 0 done, 2 bad input or a refused state, 3 hardware.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
from collections.abc import Callable, Sequence
from importlib import import_module

from device.cli.board import chosen_board
from device.cli.console import print_error
from device.cli.parser import OLD_COMMANDS, make_parser
from device.errors import DeviceError, FrameNotConfirmed, InstrumentBusy
from device.shutdown import signals_as_keyboard_interrupt
from hal.errors import BoardProfileError, HalError, OperatorError


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code."""
    options = make_parser().parse_args(arguments)
    if new_name := OLD_COMMANDS.get(options.command_name):
        print_error(f"`{options.command_name}` is now called `{new_name}`; the old name will be removed")
    try:
        with signals_as_keyboard_interrupt(signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT):
            options.board = chosen_board(options.board)
            return _function(options.command)(options)
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


def _function(command: str) -> Callable[[argparse.Namespace], int]:
    """The function of a command, "module:function" in this room, imported now: most need little of the rest."""
    module, _, name = command.partition(":")
    function: Callable[[argparse.Namespace], int] = getattr(import_module(f"device.cli.{module}"), name)
    return function


def _fail(what: object, code: int) -> int:
    print_error(what)
    return code
