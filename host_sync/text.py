"""Makes text from files and users safe to print."""

from __future__ import annotations


def printable(text: str) -> str:
    """The text with every control character escaped, so that a record or file name cannot control a terminal."""
    return "".join(one if one.isprintable() else ascii(one)[1:-1] for one in text)
