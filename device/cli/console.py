"""Common part of every command: lines on the terminal, types of arguments, the store of the options."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

from cyclopts import Parameter
from msgspec import ValidationError, convert

if TYPE_CHECKING:
    from device.store.store import BundleStore
    from hal.interfaces import Clock

MAX_PORT: Final = 65535
MAX_LENGTH_MM: Final = 1000.0
MAX_COUNT: Final = 1_000_000


@dataclass(frozen=True, slots=True)
class Options:
    """The options that stand before every command.

    board : name or path of the board profile
    store_folder : folder of scans and calibrations, None for the default one
    """

    board: str
    store_folder: Path | None = None


Given = Annotated[Options, Parameter(parse=False)]
"""How a command receives these options."""

GivenSimulated = Annotated[Options, Parameter(parse=False)]
"""The same of a command that is about a simulated handheld, as its parameter `simulated`: the board is the twin unless
one is named.
"""


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


def store_folder(options: Options) -> Path:
    """Return the folder given with `--store`, or the default one."""
    from device.store.store import default_store

    return options.store_folder or default_store()


def open_store(options: Options, clock: Clock | None = None) -> BundleStore:
    """Return the store of the options; without a clock it takes the system's."""
    from device.store.store import BundleStore  # here and above: help and wrong arguments need no store
    from hal.clock import SystemClock

    return BundleStore(store_folder(options), clock or SystemClock())


def _text(_: Any, tokens: Sequence[Any]) -> str:
    text: str = tokens[0].value
    try:
        text.encode()
    except UnicodeEncodeError as error:
        raise ValueError(f"{text!r} is not valid UTF-8 text") from error
    from device.bundles.record import Text as Stored  # here, because only labels need it
    from hal.validation import explain_validation

    try:
        return convert(text.strip(), Stored)
    except ValidationError as error:
        raise ValueError(f"{text[:20] + '…'!r} {explain_validation(error)}") from error


def _length_mm(_: Any, tokens: Sequence[Any]) -> float:
    text = tokens[0].value
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value < MAX_LENGTH_MM:
        raise ValueError(f"{text!r} is not a length between 0 and {MAX_LENGTH_MM:g} mm")
    return value


def _whole(kind: str, most: int, _: Any, tokens: Sequence[Any]) -> int:
    text = tokens[0].value
    if not (text.isdecimal() and 1 <= int(text) <= most):
        raise ValueError(f"{text!r} is not a {kind}: give a number from 1 to {most}")
    return int(text)


Text = Annotated[str, Parameter(converter=_text)]
"""Valid UTF-8."""

LengthMm = Annotated[float, Parameter(converter=_length_mm)]
"""A length in mm."""

Port = Annotated[int, Parameter(converter=partial(_whole, "port", MAX_PORT))]
"""A TCP port."""

Count = Annotated[int, Parameter(converter=partial(_whole, "count", MAX_COUNT))]
"""1 or more."""
