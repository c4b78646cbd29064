"""What every command shares: lines on the terminal, types of arguments, the store of the options."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from device.store.store import BundleStore
    from hal.interfaces import Clock

Commands = argparse._SubParsersAction  # the type of `add_subparsers()`, which argparse does not export
MAX_PORT: Final = 65535
MAX_LENGTH_MM: Final = 1000.0
MAX_COUNT: Final = 1_000_000


def print_line(line: str) -> None:
    """Print a line to standard output at once."""
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def print_note(line: str) -> None:
    """Print a line for people to standard error, where standard output holds a document."""
    sys.stderr.write(line + "\n")
    sys.stderr.flush()


def print_error(what: object) -> None:
    """Print an error or warning to standard error, after the program's name."""
    sys.stderr.write(f"retroscan: {what}\n")


def store_folder(options: argparse.Namespace) -> Path:
    """The folder given with `--store`, or the default one."""
    from device.store.store import default_store

    folder: Path = options.store or default_store()
    return folder


def open_store(options: argparse.Namespace, clock: Clock | None = None) -> BundleStore:
    """The store of the options; without a clock it takes the system's."""
    from device.store.store import BundleStore  # here and above: help and wrong arguments need no store
    from hal.clock import SystemClock

    return BundleStore(store_folder(options), clock or SystemClock())


def text_argument(text: str) -> str:
    """Type of an argument that must be valid UTF-8."""
    try:
        text.encode()
    except UnicodeEncodeError as error:
        raise argparse.ArgumentTypeError(f"{text!r} is not valid UTF-8 text") from error
    return text


def folder_argument(text: str) -> Path:
    """Type of an argument that names a folder or file."""
    if not text:
        raise argparse.ArgumentTypeError("a folder name must not be empty")
    return Path(text)


def length_mm_argument(text: str) -> float:
    """Type of an argument that gives a length in mm."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value < MAX_LENGTH_MM:
        raise argparse.ArgumentTypeError(f"{text!r} is not a length between 0 and {MAX_LENGTH_MM:g} mm")
    return value


def port_argument(text: str) -> int:
    """Type of an argument that gives a TCP port."""
    if not (text.isdecimal() and 1 <= int(text) <= MAX_PORT):
        raise argparse.ArgumentTypeError(f"{text!r} is not a port: give a number from 1 to {MAX_PORT}")
    return int(text)


def count_argument(text: str) -> int:
    """Type of an argument that counts something: 1 or more."""
    if not (text.isdecimal() and 1 <= int(text) <= MAX_COUNT):
        raise argparse.ArgumentTypeError(f"{text!r} is not a count: give a number from 1 to {MAX_COUNT}")
    return int(text)
