"""Tables as spreadsheets of any language write and open them."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import pytest

from host_sync.csv_table import number_in, read_table, table_text
from host_sync.errors import MeasurementError
from host_sync.gage.gage_table import numbers, read_rows

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
        "part;operator;value;µ\nA;Ada;1.5;\n".encode("cp1252"),
    ],
)
def test_tables_of_other_languages_are_read(data: bytes, tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_bytes(data)
    assert numbers(read_rows(path, "value"), "table") == [("A", "Ada", 1.5)]


def test_a_number_that_a_comma_cuts_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text("part,operator,value\nA,Ada,1,5\n")
    with pytest.raises(MeasurementError, match="line 2 has more cells than the line of names"):
        read_table(path, MeasurementError)
    assert math.isnan(number_in("1,5,0"))


def test_a_spreadsheet_of_a_decimal_comma_opens_numbers_and_no_formula() -> None:
    text = table_text([("µ", "=1+1"), (-0.5, None), (1e-7, math.nan), (3, True)], semicolon=True)
    assert text == "\ufeffµ;'=1+1\n-0,5;\n1e-07;\n3;True\n"
    assert list(csv.reader(table_text([(-0.5, "a;b", -3)]).splitlines())) == [["-0.5", "a;b", "-3"]]
