"""Texts from files and people, made fit to be shown."""

from __future__ import annotations


def printable(text: str) -> str:
    """The same with every control character written out: what a record or a file's name says never moves a terminal."""
    return "".join(one if one.isprintable() else ascii(one)[1:-1] for one in text)
