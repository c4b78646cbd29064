"""Explains what is wrong with a record, a recipe or a board profile: the key, its problem and what is accepted.

msgspec's own messages name Python's types; the sentences here use a reader's words.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from typing import Any, Final

import msgspec
from msgspec import inspect

_STEP: Final = re.compile(r"\.?([A-Za-z_][A-Za-z0-9_]*)|\[(\d+)\]|\[\.\.\.\]")


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
        lambda m: f"is {_kinds(m[2])}; accepted is {_kinds(m[1])}" + _without_quotes(m[1], m[2]),
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
        r"Expected `array` of length (>=|<=) (\d+)",
        lambda m: f"is too {'short' if m[1] == '>=' else 'long'}; accepted is a list of {_BOUNDS[m[1]]} {m[2]}",
    ),
    (
        r"Expected `str` matching regex '.*x1f.*'",
        lambda _: 'holds a line break or a tab, which "\\n" and "\\t" in a path make: write / in paths',
    ),
    (
        r"Expected `str` of length (>=|<=) (\d+)",
        lambda m: f"is too {'short' if m[1] == '>=' else 'long'}; accepted is {_BOUNDS[m[1]]} {m[2]} characters",
    ),
    (r"Object missing required field `([^`]+)`", lambda m: f"{m[1]} is missing"),
    (r"Object contains unknown field `([^`]+)`", lambda m: f"{m[1]} is not a key"),
    (r"Invalid enum value (.+)", lambda m: f"{m[1]} is not accepted"),
)


def split_validation(error: msgspec.ValidationError) -> tuple[str, str]:
    """Key, empty for the whole file, and problem, such as "is a whole number; accepted is a text"."""
    key, problem = _located(error)
    for pattern, words in _PATTERNS:
        if found := re.fullmatch(pattern, problem):
            return key, words(found)
    return key, problem


def explain_validation(error: msgspec.ValidationError) -> str:
    """Key and problem as one clause."""
    key, problem = split_validation(error)
    return f"{key}: {problem}" if key else problem


def explain_with_accepted(error: msgspec.ValidationError, kind: type[msgspec.Struct], data: object) -> str:
    """Key, problem and all that is accepted there, for a record of type `kind` and its parsed but unchecked `data`."""
    key, problem = _located(error)
    if lost := re.search(r"missing required field `(\w+)`", problem):
        key = f"{key}.{lost[1]}" if key else lost[1]
        return f"{key}: is missing; accepted: {accepted_at(kind, key)}"
    if extra := re.search(r"unknown field `(\w+)`", problem):
        return f"{key or 'top level'}: has no key {extra[1]!r}; accepted: {accepted_at(kind, key)}"
    return f"{key or 'top level'}: {_value_at(data, key)} is not accepted; accepted: {accepted_at(kind, key)}"


def accepted_at(kind: type[msgspec.Struct], key: str) -> str:
    """Return the description of the values accepted at a key such as "lights[1].colour"."""
    found: inspect.Type = inspect.type_info(kind)
    for name, _ in _steps(key):
        found = _step_into(_bare(found), name)
    return _describe(found)


def not_finite(record: msgspec.Struct, prefix: str = "") -> Iterator[str]:
    """Yield keys of all numbers that are infinite or NaN."""
    for name in record.__struct_fields__:
        yield from _not_finite(getattr(record, name), f"{prefix}{name}")


def _not_finite(value: object, key: str) -> Iterator[str]:
    if isinstance(value, float) and not math.isfinite(value):
        yield key
    elif isinstance(value, msgspec.Struct):
        yield from not_finite(value, f"{key}.")
    elif isinstance(value, tuple):
        for index, item in enumerate(value):
            yield from _not_finite(item, f"{key}[{index}]")


def _located(error: msgspec.ValidationError) -> tuple[str, str]:
    """Key and problem in msgspec's words."""
    problem, _, where = str(error).partition(" - at `")
    return re.sub(r"^(key in )?\$\.?", "", where.rstrip("`")), problem


def _kinds(names: str) -> str:
    """For example "a number or nothing" for "float | null"."""
    return " or ".join(_KINDS.get(name.strip(), name.strip()) for name in names.split("|"))


def _without_quotes(accepted: str, given: str) -> str:
    """Return the mend of a number that was written as a text."""
    return ": write it without quotes and unit" if given == "str" and re.search("int|float", accepted) else ""


def _steps(key: str) -> Iterator[tuple[str, int | None]]:
    """Yield a key's steps: a name, or an empty name and an index."""
    for match in _STEP.finditer(key):
        yield match[1] or "", None if match[2] is None else int(match[2])


def _value_at(data: Any, key: str) -> str:
    """Return the value in the file, as it would be written there."""
    for name, index in _steps(key):
        data = data[name] if name else data[index or 0]
    return "a table" if isinstance(data, dict) else f"a list of {len(data)}" if isinstance(data, list) else repr(data)


def _bare(kind: inspect.Type) -> inspect.Type:
    """Return the type without metadata or an alternative None."""
    if isinstance(kind, inspect.Metadata):
        return _bare(kind.type)
    if isinstance(kind, inspect.UnionType):
        return _bare(next(part for part in kind.types if not isinstance(part, inspect.NoneType)))
    return kind


def _step_into(kind: inspect.Type, name: str) -> inspect.Type:
    if isinstance(kind, inspect.StructType):
        return next(field.type for field in kind.fields if field.name == name)
    if isinstance(kind, inspect.TupleType):
        return kind.item_types[0]
    if isinstance(kind, inspect.VarTupleType):
        return kind.item_type
    return kind


def _describe(kind: inspect.Type) -> str:
    bare = _bare(kind)
    match bare:
        case inspect.LiteralType():
            return ", ".join(str(value) for value in bare.values)
        case inspect.IntType():
            return f"a whole number{_bounds(bare)}"
        case inspect.FloatType():
            return f"a number{_bounds(bare)}"
        case inspect.BoolType():
            return "true, false"
        case inspect.StrType():
            return "a text" if bare.min_length is None else f"a text of {bare.min_length} letters or more"
        case inspect.TupleType():
            return f"a list of {len(bare.item_types)}, each {_describe(bare.item_types[0])}"
        case inspect.VarTupleType():
            return f"a list, each {_describe(bare.item_type)}"
        case inspect.StructType():
            return ", ".join(field.name for field in bare.fields)
        case _:
            return "another type of value"


def _bounds(kind: inspect.IntType | inspect.FloatType) -> str:
    """Return limits of a number, such as " from 0 to 1"."""
    parts = []
    if kind.gt is not None:
        parts.append(f"above {kind.gt:g}")
    if kind.ge is not None:
        parts.append(f"from {kind.ge:g}")
    if kind.le is not None:
        parts.append(f"to {kind.le:g}")
    if kind.multiple_of is not None:
        parts.append(f"that is a multiple of {kind.multiple_of:g}")
    return "".join(f" {part}" for part in parts)
