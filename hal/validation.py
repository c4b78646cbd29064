"""TOML and JSON decoded to a type, and their faults in one clause: the key, its problem, what is accepted."""

from __future__ import annotations

import atexit
import gc
import math
import re
from codecs import BOM_UTF8, BOM_UTF16_BE, BOM_UTF16_LE, BOM_UTF32_BE, BOM_UTF32_LE
from collections.abc import Callable, Iterator
from typing import Any, Final, TypeVar

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
    (r"Expected `str` matching regex '.*'", lambda _: "is not of the accepted form"),
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


# msgspec 0.22 may crash when the interpreter's last garbage collection frees record types that refer to each other,
# after all work is done (msgspec issue 717). Readers of records import this module; what is frozen is left to the
# system.
atexit.register(gc.freeze)

T = TypeVar("T")

MAX_SHOWN: Final = 60
_QUOTES: Final = "“”„‟‘’‚‛«»″′`´＂"
_HINTS: Final[tuple[tuple[str, str], ...]] = (
    (f"[{_QUOTES}]", 'write straight quotes, "…"'),
    (r"[\u00a0\u2007\u202f\u200b\ufeff]", "remove a space of another kind, which other programs bring along"),
    (r"=\s*([-+]?\d+),(\d+)\s*([,}#]|$)", r"write a decimal point, \1.\2"),
    (r"=\s*[-+]?\d+[.'\u2019]\d+,\d+", "write a decimal point, and no sign between thousands"),
    (r"[\[,]\s*([-+]?\d+),(\d+)\s*(#.*)?$", r"write a decimal point, \1.\2"),
    (r'"[^"]*\\', r"write / in paths instead of \\, or put the text between ' and '"),
    (r"^\s*(//|;|--)", "begin remarks with #"),
    (r"^\s*[\w-]+\s*:", 'write = between a key and its value, such as name = "bench"'),
    (r"=\s*[-+]?[\d.]+\s*[A-Za-zµ°%]", "write numbers without a unit"),
    (r"=\s*[−–—]\s*[\d.]", "write a minus as -"),
    (r"\{[^}]*$", "write all between { and } on one line"),
    (r"=\s*[-+]?[\d.]+\s*(;|,|//)", "end the line after the value, or begin remarks with #"),
    (r"=\s*(True|False|TRUE|FALSE|yes|no|on|off)\b", "write true or false"),
    (r"=\s*[-+]?(\.\d|\d+\.(\D|$)|0\d)", "write digits on both sides of the point, and no 0 in front of others"),
    (r"=\s*[^\W\d][^\"']*$", 'put texts between quotes, "…"'),
    (r"=\s*[^\x00-\x7f]", "write digits from 0 to 9 without signs of another script"),
    (r"=\s*(#.*)?$", "write a value after ="),
    (r"""^[^"]*"([^"]*"[^"]*")*[^"]*$|^[^']*'([^']*'[^']*')*[^']*$""", "close the quotes"),
    (r"^\s*[\w-]+\s*(#.*)?$", "write = and a value after a key"),
)


def decode_toml(data: bytes, kind: type[T]) -> T:
    """Return the record in TOML; the mark with which some editors begin UTF-8 is skipped.

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
    """Return the record in JSON, which programs write and begin without a mark; errors as for `decode_toml`."""
    return _decoded(lambda: msgspec.json.decode(data, type=kind), data, "JSON")


def _decoded(decode: Callable[[], T], text: bytes, form: str) -> T:
    try:
        return decode()
    except msgspec.ValidationError:
        raise
    except RecursionError as error:
        raise msgspec.DecodeError(f"is not {form}: its tables are nested too deeply") from error
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise msgspec.DecodeError(f"is not {form}: {_reason(text, error, form)}") from error


def _reason(data: bytes, error: Exception, form: str) -> str:
    """Return what the file is not; the libraries' own messages on bytes that are not text name codecs and bytes."""
    fewer, more = sorted((data[::2].count(0), data[1::2].count(0)))
    if data.startswith((BOM_UTF32_LE, BOM_UTF32_BE)):
        return "it is text in UTF-32: save it as UTF-8"
    if data.startswith((BOM_UTF16_LE, BOM_UTF16_BE)) or (not fewer and 4 * more > len(data)):
        return "it is text in UTF-16: save it as UTF-8"
    try:
        text = data.decode()
    except UnicodeDecodeError:
        return "it is not text in UTF-8: save it as UTF-8"
    if b"\0" in data:
        return "it is not text"
    return _toml_advice(text, str(error)) if form == "TOML" else str(error)


def _toml_advice(text: str, error: str) -> str:
    """Return the line that a decoder's error names and what to write there, as one clause."""
    if found := re.search(r"\(at line (\d+), column \d+\)", error):
        number = int(found[1])
    elif "at end of document" in error:
        number = text.rstrip().count("\n") + 1
    else:
        return error
    if "\n" not in text and "\r" in text.rstrip():
        return "its lines end as on an old Macintosh: save it with line ends of Unix or Windows"
    lines = text.splitlines()
    line = lines[min(number, len(lines)) - 1].strip() if lines else ""
    shown = line if len(line) <= MAX_SHOWN else f"{line[:MAX_SHOWN]}…"
    return f"line {number}, {shown}: {_hint(line, error)}"


def _hint(line: str, error: str) -> str:
    if "Cannot declare" in error or "Cannot overwrite" in error:
        if re.match(r"\[\w+\]", line):
            return f"this table appears twice: leave one out, or write [{line}] where several are accepted"
        return "this key appears twice: leave one out"
    for pattern, words in _HINTS:
        if found := re.search(pattern, line):
            return found.expand(words)
    return re.sub(r" \(at .*\)$", "", error).lower()
