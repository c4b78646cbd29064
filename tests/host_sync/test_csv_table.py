"""Tables as spreadsheets of any language write and open them."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import pytest

from host_sync.csv_table import number_in, read_table, table_text
from host_sync.errors import MeasurementError
from host_sync.gage import numbers, read_rows

ROWS = [("part", "operator", "value"), ("A", "Ada", 1.5), ("B", "Ö, Bo", -0.25)]


@pytest.mark.parametrize("semicolon", [False, True])
def test_what_is_written_is_read(semicolon: bool, tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text(table_text(ROWS, semicolon=semicolon), encoding="utf-8")
    assert numbers(read_rows(path, "value"), "table") == [("A", "Ada", 1.5), ("B", "Ö, Bo", -0.25)]


@pytest.mark.parametrize(
    "data",
    [
        b"part;operator;value\r\nA;Ada;1,5\r\n",
        "\ufeffpart; operator; value\nA; Ada; 1,5\n".encode(),
        "part\toperator\tvalue\nA\tAda\t1,5\n".encode("utf-16"),
        b'part,operator,value\nA,Ada,"1,5"\n',
        "part\toperator\tvalue\nA\tAda\t1,5\n".encode("utf-32"),
        "part;operator;value;µ\nA;Ada;1.5;\n".encode("cp1252"),
        b"sep=|\r\npart|operator|value\r\nA|Ada|1,5\r\n",
        b'"sep=;"\rpart;operator;value\rA;Ada;1,5\r',
        b"\r\n;;\r\nPart;Operator;VALUE\r\nA;Ada;1,5\r\n",
    ],
)
def test_tables_of_other_languages_are_read(data: bytes, tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_bytes(data)
    assert numbers(read_rows(path, "value"), "table") == [("A", "Ada", 1.5)]


def test_a_quotation_mark_that_is_left_open_is_named_and_a_note_over_two_lines_is_read(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text('part,operator,value\nA,"Ada,1.5\nB,Bo,2.5\n')
    with pytest.raises(MeasurementError, match="a quotation mark in line 2 is not closed"):
        read_table(path, MeasurementError)
    path.write_text('part,value,note\nA,1.5,"two\nlines"\n')
    assert [row["value"] for row in read_table(path, MeasurementError)] == ["1.5"]


def test_a_number_that_a_comma_cuts_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text("part,operator,value\nA,Ada,1,5\n")
    with pytest.raises(MeasurementError, match="line 2 has more cells than the line of names"):
        read_table(path, MeasurementError)
    assert math.isnan(number_in("1,5,0"))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("part|operator|value\nA|Ada|1.5\n", "has no column part, operator, value: .* commas, semicolons or tabs"),
        ("part,operator,value,Value\nA,Ada,1.5,2.5\n", "has two columns value: leave the right one"),
        ("part;operator;value\n\nA;Ada;\n", "row 1 below the line of names: a cell is empty"),
        ("part;operator;value\nA;Ada;1,234\nB;Ada;987.6\n", "points and commas: write no sign between thousands"),
    ],
)
def test_a_table_that_can_be_read_in_two_ways_is_refused(text: str, words: str, tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text(text)
    with pytest.raises(MeasurementError, match=words):
        numbers(read_rows(path, "value"), "table")


def test_a_spreadsheet_of_a_decimal_comma_opens_numbers_and_no_formula() -> None:
    text = table_text([("µ", "=1+1"), (-0.5, None), (1e-7, math.nan), (3, True)], semicolon=True)
    assert text == "\ufeffµ;'=1+1\n-0,5;\n1e-07;\n3;True\n"
    assert list(csv.reader(table_text([(-0.5, "a;b", -3)]).splitlines())) == [["-0.5", "a;b", "-3"]]
