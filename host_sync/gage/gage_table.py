"""Rows of a gage study, from a CSV file or from results, arranged by parts, operators and repeats."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from device.surface.fields import Float64Array
from host_sync.errors import MeasurementError

MAX_BYTES: Final = 64 << 20


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
    try:
        if path.stat().st_size > MAX_BYTES:
            raise MeasurementError(f"{path}: is larger than any table of measurements: name another file")
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except OSError as error:
        raise MeasurementError(f"{path}: cannot be read ({error.strerror}): name a CSV file") from error
    except UnicodeDecodeError as error:
        raise MeasurementError(f"{path}: is not UTF-8 text: save it as UTF-8") from error
    reader = csv.DictReader(lines, skipinitialspace=True)
    wanted = ("part", "operator", value_column)
    missing = [name for name in wanted if name not in (reader.fieldnames or ())]
    if missing:
        raise MeasurementError(
            f"{path}: has no column {', '.join(missing)}: its first line must name {', '.join(wanted)}"
        )
    rows = []
    for cells in reader:
        part, operator, value = (str(cells[name] or "").strip() for name in wanted)
        if not (part and operator and value):
            raise MeasurementError(f"{path}: line {reader.line_num}: a cell is empty: fill it in")
        rows.append(GageRow(part, operator, value))
    return rows


def numbers(rows: Iterable[GageRow], source: str) -> list[tuple[str, str, float]]:
    """Part, operator and number of each row.

    Raises
    ------
    MeasurementError
        A value is no finite number.
    """
    found = []
    for row in rows:
        try:
            number = float(row.value)
        except ValueError:
            number = float("nan")
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
