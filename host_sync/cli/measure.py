"""`retrosync measure`: measures results by a recipe; `retrosync gage-rr`: repeatability and reproducibility."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import msgspec
from cyclopts import Parameter

from device.command_line import Folder, print_json
from device.errors import DeviceError
from device.io.atomic import check_output, write_output
from host_sync.cli.console import BAD_INPUT, DONE, PARTLY, OutputFile, print_error, print_line, status_spinner
from host_sync.csv_table import BYTE_ORDER_MARK
from host_sync.errors import HostError, MeasurementError, MissingResult
from host_sync.frames.sequence import natural_order
from host_sync.library.library import Library
from host_sync.results.doubts import replacing
from host_sync.results.files import RECORD_FILE, DetailName

if TYPE_CHECKING:
    from host_sync.gage import GageRow
    from host_sync.measurement.measurement import Measurement
    from host_sync.measurement.recipe import Recipe

Region = tuple[float, float, float, float]


def measure_command(
    *results: Path,
    recipe: Path | None = None,
    library: Folder | None = None,
    form: str | None = None,
    s_filter_um: float | None = None,
    l_filter_um: float | None = None,
    region_um: Region | None = None,
    parameters: Annotated[tuple[str, ...] | None, Parameter(consume_multiple=True)] = None,
    spectrum: bool | None = None,
    keep_extrapolated: bool | None = None,
    detail: DetailName | None = None,
    coverage_factor: Annotated[Literal[1, 2] | None, Parameter(name=("--coverage-factor", "-k"))] = None,
    json: bool = False,
    json_file: OutputFile = None,
    csv: OutputFile = None,
    semicolon: bool = False,
    trend: Path | None = None,
) -> int:
    """Measure results: form removal, S- and L-filter, ISO 25178 parameters, a recipe's quantities, each with its ±.

    Parameters
    ----------
    results
        Folders that reconstruct wrote, folders of such folders, or surface files of other instruments (TMD; with the
        extra `formats` X3P, SUR, AL3D, SDF, GWY, OPD, PLUX and more). With --library, scans of it by id, label's name
        or part; all by default.
    recipe
        TOML file of the measurement recipe; the options below change it. A number that fails its tolerance ends the
        command with exit code 1.
    library
        Folder of pulled scans, each with its newest results.
    form
        none, mean, plane, sphere, polynomial-2 … polynomial-10.
    s_filter_um
        Nesting index of the Gaussian filter that removes shorter wavelengths.
    l_filter_um
        Nesting index of the Gaussian filter that removes longer wavelengths.
    region_um
        Left, top, right, bottom, from the centre of the first pixel.
    parameters
        Groups (height, hybrid, spatial, functional) or single names.
    spectrum
        Also measure the power spectral density.
    keep_extrapolated
        Include pixels with slopes beyond those of the calibration's balls, which areal parameters leave out by default.
    detail
        Measure everything on raw or on shrunk detail. Default: roughness on raw detail with its noise subtracted, steps
        and radii on shrunk detail.
    coverage_factor
        1 for standard uncertainties, 2 for about 95 %.
    json
        Print one JSON document instead of the table.
    json_file
        Also write that document to this file.
    csv
        Also write all quantities to this file; - writes only them, to the output.
    semicolon
        Write csv with semicolons and decimal commas, for spreadsheets of languages with a decimal comma.
    trend
        Also print each number's trend over the results (mean, range, control limits, Cpk) with its ±, and draw it to
        this .png, .pdf or .svg: numbers with a tolerance, or the first twelve. JSON gets them as its last element.
    """
    given = {
        "form": form,
        "s_filter_um": s_filter_um,
        "l_filter_um": l_filter_um,
        "region_um": region_um,
        "parameters": parameters,
        "spectrum": spectrum,
        "keep_extrapolated": keep_extrapolated,
        "detail": detail,
        "coverage_factor": coverage_factor,
    }
    chosen = chosen_recipe(recipe, {name: value for name, value in given.items() if value is not None})
    if trend is not None:
        _check_trend(trend)
    for place in (json_file, csv, trend):
        if place is not None and place != Path("-"):
            check_output(place)  # before minutes of work
    done: list[Measurement] = []
    failed = False
    alone = json or csv == Path("-")
    for found in measured(result_folders(results, library), chosen):
        if isinstance(found, str):
            failed = True
            print_error(found, PARTLY)
            continue
        from host_sync.measurement.measurement import as_text

        done.append(found)
        failed = failed or bool(found.failed) or found.fails
        if not alone:
            for line in (*as_text(found).splitlines(), ""):
                print_line(line)
    if trend is not None:
        failed = name_copies(done) or failed
    if json or json_file is not None:
        _write_json(done, json_file, on_output=json, with_trend=trend is not None)
    if csv is not None:
        _write_csv(done, csv, semicolon=semicolon)
    if trend is not None:
        _write_trend(done, trend, quiet=alone)
    if failed:
        return PARTLY if done else BAD_INPUT
    return DONE


def chosen_recipe(path: Path | None, given: dict[str, object]) -> Recipe:
    """Return the recipe of a file, or the default, with the options of the command line.

    Raises
    ------
    MeasurementError
        Names the key and what is accepted.
    """
    from host_sync.measurement.recipe import Recipe, checked, from_options, read_recipe

    recipe = read_recipe(path) if path else Recipe()
    return checked(from_options(recipe, given), "options") if given else recipe


def result_folders(names: Sequence[Path], library: Path | None) -> list[Path | str]:
    """Return the result folders in order; a sentence for a scan without results.

    Raises
    ------
    MeasurementError
        No result is named.
    LibraryError, NoSuchBundle
        The library cannot be read or has no such scan.
    """
    if library is None:
        if not names:
            raise MeasurementError("name folders that retrosync reconstruct wrote, or --library LIB")
        return [found for name in names for found in _results_in(name)]
    held = Library(library)
    listing = held.scans()
    scans = [held.named(str(name)) for name in names] if names else list(listing.bundles)
    found: list[Path | str] = []
    for scan in scans:
        try:
            found.append(held.newest_result(scan))
        except MissingResult as error:
            found.append(str(error))
    if not names:
        found += [f"{bundle.directory.name}: {bundle.reason}" for bundle in listing.damaged]
    if not found:
        raise MeasurementError(f"{library} holds no scans: pull some first")
    return found


def _results_in(place: Path) -> list[Path]:
    """Return the place itself, or the results in it where it is a folder of results."""
    if not place.is_dir() or (place / RECORD_FILE).is_file():
        return [place]
    return sorted((path.parent for path in place.glob(f"*/{RECORD_FILE}")), key=natural_order) or [place]


def measured(folders: Sequence[Path | str], recipe: Recipe, *, samples: bool = True) -> Iterator[Measurement | str]:
    """Yield the measurement of each folder in turn, or a sentence that says why it cannot be measured."""
    with status_spinner() as report_progress:
        report_progress("loading compiled code")
        from host_sync.measurement.measure import measure_result

        for folder in folders:
            if isinstance(folder, str):
                yield folder
                continue
            try:
                yield measure_result(folder, recipe, report_progress, samples=samples)
            except (DeviceError, HostError) as error:
                words = str(error)
                yield words if words.startswith(str(folder)) else f"{folder}: {words}"


def _write_json(done: Sequence[Measurement], path: Path | None, *, on_output: bool, with_trend: bool) -> None:
    from host_sync.measurement.measurement import as_record
    from host_sync.measurement.trend import trend_record

    records = [as_record(one) for one in done] + ([trend_record(done)] if with_trend else [])
    if on_output:
        print_json(records)
    if path is not None:
        write_text(path, msgspec.json.format(msgspec.json.encode(records), indent=2).decode())


def _write_csv(done: Sequence[Measurement], path: Path, *, semicolon: bool) -> None:
    from host_sync.measurement.measurement import as_csv

    write_text(path, as_csv(done, semicolon=semicolon))


def name_copies(done: list[Measurement]) -> bool:
    """Mark copies of one press, which take no part in a trend, and name them; returns whether there were any."""
    from host_sync.measurement.measurement import copies_among, copy_words, mark_copies

    copies = copies_among(done)
    for place, first in copies.items():
        print_error(f"{copy_words(done[place], first)}: no trend has it", PARTLY)
    done[:] = mark_copies(done)
    return bool(copies)


def _check_trend(path: Path) -> None:
    # The drawing library is loaded only where a trend is wanted.
    from host_sync.report.population import check_trend

    check_trend(path)


def _write_trend(done: Sequence[Measurement], path: Path, *, quiet: bool) -> None:
    from host_sync.measurement.trend import trends
    from host_sync.report.population import write_trend

    write_trend(path, done)
    for (subject, name), (example, _, found) in ({} if quiet else trends(done)).items():
        print_line(f"{subject} {name}: {found.text(example.unit)}")


def write_text(path: Path, text: str) -> None:
    """Write a text to a file atomically, or to standard output if it is -.

    Raises
    ------
    OutputError
        The place cannot be written.
    """
    if path == Path("-"):
        sys.stdout.write(text.removeprefix(BYTE_ORDER_MARK).rstrip("\n") + "\n")
        return
    write_output(path, text.encode())


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
    from host_sync.gage import crossed, numbers, read_rows, study, study_text

    doubts: list[str] = []
    if table is not None:
        unit, what = "", str(table)
        rows = numbers(read_rows(table, "value"), str(table))
    else:
        chosen, what = chosen_recipe(recipe, {}), number
        planned = read_rows(plan, "result") if plan else _annotated_rows(Library(library), scans) if library else []
        rows, unit, doubts = _measured_rows(planned, chosen, number)
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


def _annotated_rows(library: Library, names: Sequence[str]) -> list[GageRow]:
    """Part, operator and newest results of each scan."""
    from host_sync.gage import GageRow

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


def _measured_rows(
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
