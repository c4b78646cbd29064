"""`retrosync gage-rr`: gage repeatability and reproducibility."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from device.command_line import Folder, print_json
from host_sync.cli.console import DONE, OutputFile, print_line
from host_sync.cli.measure import chosen_recipe, measured, write_text
from host_sync.errors import MeasurementError
from host_sync.library.library import Library
from host_sync.results.doubts import replacing

if TYPE_CHECKING:
    from host_sync.gage.gage import GageRow
    from host_sync.measurement.recipe import Recipe


def gage_command(
    *scans: str,
    table: Path | None = None,
    plan: Path | None = None,
    library: Folder | None = None,
    recipe: Path | None = None,
    number: str = "surface/Sa",
    tolerance: float | None = None,
    json: bool = False,
    json_file: OutputFile = None,
) -> int:
    """Gage R&R from repeated scans of the same parts (crossed ANOVA): repeatability, reproducibility, categories.

    Parameters
    ----------
    scans
        Scans of the library; by default all that no retake replaced. Their annotations name part and operator.
    table
        CSV file of measured values, with the columns part, operator, value.
    plan
        CSV file of results, with the columns part, operator, result.
    library
        Folder of pulled scans, each with its newest results.
    recipe
        TOML file of the measurement recipe.
    number
        Quantity of the recipe: subject, slash, name.
    tolerance
        Tolerance width, in the quantity's unit.
    json
        Print the study as one JSON document instead of the table.
    json_file
        Also write that document to this file.
    """
    if sum(one is not None for one in (table, plan, library)) != 1:
        raise MeasurementError("name one source: --table FILE, --plan FILE or --library LIB")
    if tolerance is not None and not 0.0 < tolerance < float("inf"):
        raise MeasurementError(f"tolerance: {tolerance:g} is not a width: give a positive number")
    from host_sync.gage.gage import crossed, numbers, read_rows, study, study_text

    doubts: list[str] = []
    if table is not None:
        unit, what = "", str(table)
        rows = numbers(read_rows(table, "value"), str(table))
    else:
        chosen, what = chosen_recipe(recipe, {}), number
        planned = read_rows(plan, "result") if plan else _annotated(Library(library), scans) if library else []
        rows, unit, doubts = _measured(planned, chosen, number)
    found = study(*crossed(rows), tolerance=tolerance)
    if not json:
        for line in study_text(found, what, unit).splitlines():
            print_line(line)
        for words in doubts:
            print_line(f"  doubt: {words}")
    facts = {"number": what, "unit": unit, "doubts": doubts, "schema": "retrograph.gage/1"}
    record = msgspec.to_builtins(found) | facts
    if json:
        print_json(record)
    if json_file is not None:
        write_text(json_file, msgspec.json.format(msgspec.json.encode(record), indent=2).decode())
    return DONE


def _annotated(library: Library, names: Sequence[str]) -> list[GageRow]:
    """Part, operator and newest results of each scan."""
    from host_sync.gage.gage import GageRow

    every = (scan for scan in library.scans().bundles if not replacing(scan.directory))
    scans = [library.named(name) for name in names] if names else list(every)
    rows = []
    for scan in scans:
        notes = scan.record.annotations
        if not (notes.part and notes.operator):
            raise MeasurementError(f"{scan.scan_id}: has no annotated part or operator: name them in a --plan file")
        rows.append(GageRow(notes.part, notes.operator, str(library.newest_result(scan))))
    if not rows:
        raise MeasurementError(f"{library.root} holds no scans: pull some first")
    return rows


def _measured(
    rows: Sequence[GageRow], recipe: Recipe, number: str
) -> tuple[list[tuple[str, str, float]], str, list[str]]:
    """Part, operator and value of each row, the values' unit, and the results' doubts."""
    subject, _, name = number.rpartition("/")
    from host_sync.measurement.measurement import copies_among, copy_words

    found = []
    doubts: list[str] = []
    unit = ""
    # The spread of the repeats replaces the samples.
    every = []
    for row, measurement in zip(rows, measured([Path(row.value) for row in rows], recipe, samples=False), strict=True):
        if isinstance(measurement, str):
            raise MeasurementError(measurement)
        every.append(measurement.numbers_only())
        known = {(one.subject, one.name): one for one in measurement.quantities}
        quantity = known.get((subject, name))
        if quantity is None:
            accepted = ", ".join(f"{one}/{other}" for one, other in known)
            raise MeasurementError(f"number: {number!r} is not in the recipe; accepted are {accepted}")
        if quantity.value is None:
            raise MeasurementError(f"{row.value}: {number} is not defined there: leave the result out, or correct it")
        found.append((row.part, row.operator, quantity.value))
        unit = quantity.unit
        doubts += [f"{row.value}: {doubt.sentence}" for doubt in measurement.doubts]
    for place, first in copies_among(every).items():
        raise MeasurementError(f"{copy_words(every[place], first)}: leave it out")
    return found, unit, doubts
