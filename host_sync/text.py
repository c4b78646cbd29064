"""Makes text from files and users safe to print."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

NAMED: Final = 3
"""Names or sentences that one message holds."""


def printable(text: str) -> str:
    """Return the text with every control character escaped, so that a record or file name cannot control a terminal."""
    return "".join(one if one.isprintable() else ascii(one)[1:-1] for one in text)


def some_of(names: Sequence[str]) -> str:
    """Return the first of the names, and how many more there are."""
    more = len(names) - NAMED
    return ", ".join(names[:NAMED]) + (f" and {more} more" if more > 0 else "")
