"""A recipe as TOML, with the keys that differ from their defaults."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

import msgspec

from host_sync.measurement.recipe import Recipe


def recipe_text(recipe: Recipe) -> str:
    """The text of the recipe's file; `read_recipe` of it gives the same recipe."""
    given = dict(_given(recipe))
    lines = [f"{key} = {_value(value)}" for key, value in given.items() if not _is_table(value)]
    for key, value in given.items():
        tables = [value] if isinstance(value, msgspec.Struct) else value if _is_table(value) else ()
        bracket = f"[{key}]" if isinstance(value, msgspec.Struct) else f"[[{key}]]"
        for table in tables:
            lines += ["", bracket, *(f"{name} = {_value(part)}" for name, part in _given(table))]
    return "\n".join(lines).lstrip("\n") + "\n"


def _given(table: msgspec.Struct) -> Iterator[tuple[str, Any]]:
    """Keys and values that differ from the defaults."""
    for field in msgspec.structs.fields(table):
        value = getattr(table, field.name)
        if value is not None and (field.required or value != field.default):
            yield field.encode_name, value


def _is_table(value: object) -> bool:
    return isinstance(value, msgspec.Struct) or (
        isinstance(value, tuple) and bool(value) and isinstance(value[0], msgspec.Struct)
    )


def _value(value: object) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, tuple):
        return f"[{', '.join(_value(part) for part in value)}]"
    if isinstance(value, Mapping):
        raise TypeError("a recipe has no mapping")
    return repr(value)
