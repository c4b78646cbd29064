"""Texts from files and people, made fit to be shown."""

from __future__ import annotations


def printable(text: str) -> str:
    """The text with a mark in place of what moves a terminal's cursor, rings its bell or has no sign."""
    return "".join(one if one.isprintable() else "\N{REPLACEMENT CHARACTER}" for one in text)
