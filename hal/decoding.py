"""TOML and JSON decoded to a type; what is not such text at all is one clause of an error's sentence.

The libraries' own messages on bytes that are not text name codecs and bytes; these say what the file is not.
"""

from __future__ import annotations

import atexit
import gc
import re
from codecs import BOM_UTF8, BOM_UTF16_BE, BOM_UTF16_LE, BOM_UTF32_BE, BOM_UTF32_LE
from collections.abc import Callable
from typing import Final, TypeVar

import msgspec

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
