"""Tables as CSV files: read as spreadsheets of any language write them, written so that each opens them."""

from __future__ import annotations

import csv
import io
import math
import re
from codecs import BOM_UTF16_BE, BOM_UTF16_LE, BOM_UTF32_BE, BOM_UTF32_LE
from collections.abc import Iterable, Iterator, Sequence
from itertools import dropwhile
from pathlib import Path
from typing import Final

from host_sync.errors import HostError

MAX_BYTES: Final = 64 << 20

BYTE_ORDER_MARK: Final = "\ufeff"

_SEPARATOR: Final = re.compile(r'\s*"?sep=', re.IGNORECASE)


def read_table(path: Path, error: type[HostError], columns: Sequence[str] = ()) -> list[dict[str, str]]:
    """Return rows of a table with a line of names; empty texts where a row is short, and no row that is blank.

    Commas, semicolons or tabs separate columns, as the line of names shows, or what a line "sep=|" before it states;
    text is UTF-8, UTF-16, UTF-32 or Windows-1252.

    columns : names of columns that the table must have; in the table, letters of any case spell them

    Raises
    ------
    HostError
        The file cannot be read or is no table, or has not each of these columns once, as the given class.
    """
    try:
        if path.stat().st_size > MAX_BYTES:
            raise error(f"{path}: is larger than any table: name another file")
        text = _decoded(path.read_bytes())
        if "\0" in text:
            raise error(f"{path}: is not text: name a CSV file")
        lines = list(dropwhile(_is_blank, text.splitlines()))
        stated = lines.pop(0).strip().strip('"')[4:5] if lines and _SEPARATOR.match(lines[0]) else ""
        names = lines[0] if lines else ""
        separator = stated or max(",;\t", key=names.count)
        rows = csv.DictReader(lines, restkey="more", restval="", delimiter=separator, skipinitialspace=True)
        spelled = {name.casefold(): name for name in columns}
        rows.fieldnames = [spelled.get(name.strip().casefold(), name.strip()) for name in rows.fieldnames or ()]
        if lost := [name for name in columns if name not in rows.fieldnames]:
            raise error(
                f"{path}: has no column {', '.join(lost)}: correct its line of names, with commas, semicolons or tabs "
                "between them"
            )
        if twice := [name for name in columns if rows.fieldnames.count(name) > 1]:
            raise error(f"{path}: has two columns {', '.join(twice)}: leave the right one")
        cells = [{name: cell.strip() for name, cell in row.items()} for row in _whole(rows, lines)]
        return [row for row in cells if any(row.values())]
    except OSError as problem:
        raise error(f"{path}: cannot be read ({problem.strerror}): name a CSV file") from problem
    except (UnicodeDecodeError, csv.Error) as problem:
        raise error(f"{path}: is no table ({problem}): name a CSV file, or correct it") from problem


def _is_blank(line: str) -> bool:
    return not line.strip(',;\t" ')


def _whole(rows: csv.DictReader[str], lines: Sequence[str]) -> Iterator[dict[str, str]]:
    """Yield the rows, none of which may hold more cells than there are names.

    A decimal comma would else cut a number where commas separate.

    lines : of the table; a quotation mark that is left open reaches to the last one
    """
    before = rows.line_num
    for row in rows:
        if rows.line_num == len(lines) and "".join(lines[before:]).count('"') % 2:
            raise csv.Error(f"a quotation mark in line {before + 1} is not closed")
        before = rows.line_num
        if any(row.pop("more", ())):
            raise csv.Error(f"line {rows.line_num} has more cells than the line of names")
        yield row


def number_in(cell: str) -> float:
    """Return the number in a cell, with a decimal point or comma; NaN where it is none."""
    try:
        return float(cell.replace(",", ".", 1))
    except ValueError:
        return math.nan


def table_text(rows: Iterable[Iterable[object]], *, semicolon: bool = False) -> str:
    """Return rows as CSV; None and NaN are empty cells, and no text is taken for a formula.

    semicolon : separate cells by semicolons and write decimal commas and a byte order mark, for spreadsheets of
        languages with a decimal comma
    """
    stream = io.StringIO(BYTE_ORDER_MARK if semicolon else "", newline="")
    stream.seek(0, io.SEEK_END)
    writer = csv.writer(stream, lineterminator="\n", delimiter=";" if semicolon else ",")
    writer.writerows([_cell(value, "," if semicolon else ".") for value in row] for row in rows)
    return stream.getvalue()


def _cell(value: object, point: str) -> str:
    if isinstance(value, float):
        return "" if math.isnan(value) else repr(float(value)).removesuffix(".0").replace(".", point)
    text = "" if value is None else str(value)
    return f"'{text}" if text.startswith(("=", "+", "-", "@", "\t", "\r")) and not isinstance(value, int) else text


def _decoded(data: bytes) -> str:
    if data.startswith((BOM_UTF32_LE, BOM_UTF32_BE)):  # of which the first begins as UTF-16 does
        return data.decode("utf-32")
    if data.startswith((BOM_UTF16_LE, BOM_UTF16_BE)):
        return data.decode("utf-16")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("cp1252")
