"""What is wrong with a recipe in words of its own: what a key holds, and what is accepted there."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Final

import msgspec

from device.records import explain_validation

_KINDS: Final = {
    "str": "a text",
    "int": "a whole number",
    "float": "a number",
    "bool": "true or false",
    "array": "a list",
    "object": "a table",
    "null": "nothing",
}
_BOUNDS: Final = {">": "above", ">=": "at least", "<": "below", "<=": "at most"}

_PATTERNS: Final[tuple[tuple[str, Callable[[re.Match[str]], str]], ...]] = (
    (
        r"Expected `([^`]+)`, got `([^`]+)`",
        lambda m: f"is {_kinds(m[2])}; accepted is {_kinds(m[1])}",
    ),
    (
        r"Expected `(?:float|int)` (>=|<=|>|<) (\S+?)(?:\.0)?",
        lambda m: f"is out of range; accepted is a number {_BOUNDS[m[1]]} {m[2]}",
    ),
    (
        r"Expected `array` of length (\d+)(?:, got (\d+))?",
        lambda m: f"is a list of {m[2] or 'another length'}; accepted is a list of {m[1]}",
    ),
    (
        r"Expected `str` of length (>=|<=) (\d+)",
        lambda m: f"is too {'short' if m[1] == '>=' else 'long'}; accepted is {_BOUNDS[m[1]]} {m[2]} characters",
    ),
    (r"Object missing required field `([^`]+)`", lambda m: f"{m[1]} is missing: state it"),
    (r"Object contains unknown field `([^`]+)`", lambda m: f"{m[1]} is no key"),
    (r"Invalid enum value (.+)", lambda m: f"{m[1]} is not accepted"),
)


def recipe_problem(error: msgspec.ValidationError) -> tuple[str, str]:
    """The key (empty for the whole file) and what is wrong there."""
    told = explain_validation(error)
    key, _, problem = told.partition(": ") if " - at `" in str(error) else ("", "", told)
    if not problem:
        key, problem = "", told
    for pattern, words in _PATTERNS:
        if found := re.fullmatch(pattern, problem):
            return key, words(found)
    return key, problem


def _kinds(names: str) -> str:
    """Such as "a number or nothing" for "float | null"."""
    return " or ".join(_KINDS.get(name.strip(), name.strip()) for name in names.split("|"))
