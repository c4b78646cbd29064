"""TOML and JSON decoded to a type; what is not such text at all is one clause of an error's sentence.

The libraries' own messages on bytes that are not text name codecs and bytes; these say what the file is not.
"""

from __future__ import annotations

from codecs import BOM_UTF8
from collections.abc import Callable
from typing import Any, TypeVar

import msgspec

T = TypeVar("T")


def decode_toml(data: bytes, kind: type[T]) -> T:
    """The record in TOML; the mark with which some editors begin UTF-8 is skipped.

    Raises
    ------
    msgspec.ValidationError
        A key or value is not accepted.
    msgspec.DecodeError
        It is not TOML; the message is a clause such as "is not TOML: it is not text in UTF-8".
    """
    text = data.removeprefix(BOM_UTF8)
    return _decoded(lambda: msgspec.toml.decode(text, type=kind), text, "TOML")


def decode_json(data: bytes, kind: type[T]) -> T:
    """The record in JSON, which programs write and begin without a mark; errors as for `decode_toml`."""
    return _decoded(lambda: msgspec.json.decode(data, type=kind), data, "JSON")


def _decoded(decode: Callable[[], T], text: bytes, form: str) -> T:
    try:
        return decode()
    except msgspec.ValidationError:
        raise
    except RecursionError as error:
        raise msgspec.DecodeError(f"is not {form}: its tables are nested too deeply") from error
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise msgspec.DecodeError(f"is not {form}: {_reason(text, error)}") from error


def _reason(text: bytes, error: Exception) -> Any:
    try:
        text.decode()
    except UnicodeDecodeError:
        return "it is not text in UTF-8"
    return "it is not text" if b"\0" in text else error
