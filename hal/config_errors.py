"""Explains what is wrong with a board profile: names the key and what is accepted there."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from typing import Any, Final

import msgspec
from msgspec import inspect

_STEP: Final = re.compile(r"\.?([A-Za-z_][A-Za-z0-9_]*)|\[(\d+)\]|\[\.\.\.\]")


def explain(message: str, kind: type[msgspec.Struct], data: object) -> str:
    """One sentence for a validation message of a profile whose parsed TOML is `data`."""
    what, _, where = message.partition(" - at `")
    key = re.sub(r"^(key in )?\$\.?", "", where.rstrip("`"))
    if lost := re.search(r"missing required field `(\w+)`", what):
        key = f"{key}.{lost[1]}" if key else lost[1]
        return f"{key}: is missing; accepted: {accepted_at(kind, key)}"
    if extra := re.search(r"unknown field `(\w+)`", what):
        return f"{key or 'top level'}: has no key {extra[1]!r}; accepted: {accepted_at(kind, key)}"
    found = _value_at(data, key)
    return f"{key or 'top level'}: {found} is not accepted; accepted: {accepted_at(kind, key)}"


def accepted_at(kind: type[msgspec.Struct], key: str) -> str:
    """Description of the values accepted at a key such as "lights[1].colour"."""
    found: inspect.Type = inspect.type_info(kind)
    for name, _ in _steps(key):
        found = _step_into(_bare(found), name)
    return _describe(found)


def not_finite(record: msgspec.Struct, prefix: str = "") -> Iterator[str]:
    """Keys of all numbers that are infinite or NaN."""
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


def _steps(key: str) -> Iterator[tuple[str, int | None]]:
    """A key's steps: a name, or an empty name and an index."""
    for match in _STEP.finditer(key):
        yield match[1] or "", None if match[2] is None else int(match[2])


def _value_at(data: Any, key: str) -> str:
    """The value in the file, as it would be written there."""
    for name, index in _steps(key):
        data = data[name] if name else data[index or 0]
    return "a table" if isinstance(data, dict) else f"a list of {len(data)}" if isinstance(data, list) else repr(data)


def _bare(kind: inspect.Type) -> inspect.Type:
    """The type without metadata or an alternative None."""
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
    """Limits of a number, such as " from 0 to 1"."""
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
