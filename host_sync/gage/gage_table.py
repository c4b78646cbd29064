"""Rows of a gage study, from a CSV file or from results, arranged by parts, operators and repeats."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from device.surface.fields import Float64Array
from host_sync.csv_table import number_in, read_table
from host_sync.errors import MeasurementError


@dataclass(frozen=True, slots=True)
class GageRow:
    """One measurement of a part by an operator; `value` is a number, or a result folder to measure."""

    part: str
    operator: str
    value: str


def read_rows(path: Path, value_column: str) -> list[GageRow]:
    """The rows of a CSV file whose header names the columns part, operator and the value column.

    Raises
    ------
    MeasurementError
        The file cannot be read, or lacks a column or a cell.
    """
    wanted = ("part", "operator", value_column)
    table = read_table(path, MeasurementError, wanted)
    if not table:
        raise MeasurementError(f"{path}: has no row below its line of names")
    rows = []
    for number, cells in enumerate(table, start=1):
        part, operator, value = (cells[name] for name in wanted)
        if not (part and operator and value):
            raise MeasurementError(f"{path}: row {number} below the line of names: a cell is empty: fill it in")
        rows.append(GageRow(part, operator, value))
    return rows


def numbers(rows: Iterable[GageRow], source: str) -> list[tuple[str, str, float]]:
    """Part, operator and number of each row.

    Raises
    ------
    MeasurementError
        A value is no finite number, or signs are written between thousands.
    """
    found = []
    rows = list(rows)
    texts = "".join(row.value for row in rows)
    if "," in texts and "." in texts:
        raise MeasurementError(f"{source}: values hold points and commas: write no sign between thousands")
    for row in rows:
        number = number_in(row.value)
        if not np.isfinite(number):
            raise MeasurementError(f"{source}: part {row.part}, operator {row.operator}: {row.value!r} is not a number")
        found.append((row.part, row.operator, number))
    return found


def crossed(
    measured: Sequence[tuple[str, str, float]],
) -> tuple[Float64Array, tuple[str, ...], tuple[str, ...]]:
    """Values of shape (parts, operators, repeats), part names and operator names, in order of appearance.

    Raises
    ------
    MeasurementError
        Some operator scanned some part more or less often than others.
    """
    parts = tuple(dict.fromkeys(part for part, _, _ in measured))
    operators = tuple(dict.fromkeys(operator for _, operator, _ in measured))
    counts = Counter((part, operator) for part, operator, _ in measured)
    usual = Counter(counts.values()).most_common(1)[0][0] if counts else 0
    for part in parts:
        for operator in operators:
            if counts[part, operator] != usual:
                raise MeasurementError(
                    f"part {part} was measured {counts[part, operator]} times by operator {operator} and others "
                    f"{usual} times: a crossed study needs every part equally often by every operator"
                )
    cells = {key: [value for part, operator, value in measured if (part, operator) == key] for key in counts}
    values = np.array([[cells[part, operator] for operator in operators] for part in parts], np.float64)
    return values.reshape(len(parts), len(operators), usual), parts, operators
