"""`retrosync report`: writes an HTML file per result, by a recipe, and a browser's PDF of it."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from device.command_line import Folder
from device.errors import DeviceError
from device.io.atomic import write_output
from host_sync.cli.console import BAD_INPUT, DONE, PARTLY, print_error, print_line
from host_sync.cli.measure import chosen_recipe, measured, name_copies, result_folders
from host_sync.errors import HostError, ResultError

if TYPE_CHECKING:
    from host_sync.measurement.measurement import Measurement
    from host_sync.report.writing import Picture, Report, Template

MAX_NAME = 80
NUMBERS_FILE = "numbers.csv"
POPULATION = "population"


def report_command(
    *results: Path,
    out: Folder,
    recipe: Path | None = None,
    template: Path | None = None,
    library: Folder | None = None,
    population: bool = False,
    semicolon: bool = False,
    overwrite: bool = False,
    pdf: Annotated[bool, Parameter(negative="--no-pdf")] = True,
) -> int:
    """Report on results: relief, frame, profiles, numbers with ±, calibration and provenance, as HTML and PDF.

    Chromium, Chrome or Edge prints the PDF.

    Parameters
    ----------
    results
        Folders that reconstruct wrote. With --library, scans of it; all by default.
    out
        Folder for NAME.html and NAME.pdf of each result, and numbers.csv with all quantities.
    recipe
        TOML file of the measurement recipe.
    template
        TOML file with organisation, address, logo, operator, instrument, procedure, footer, and parts of the report.
    library
        Folder of pulled scans, each with its newest results.
    population
        Write one report on all results instead, population.html and population.pdf: control charts, mean and Cpk with
        ±, outliers with thumbnails.
    semicolon
        Write numbers.csv with semicolons and decimal commas, for spreadsheets of languages with a decimal comma.
    overwrite
        Replace existing reports.
    pdf
        Write a PDF of each report, by Chromium, Chrome or Edge; --no-pdf writes HTML alone.
    """
    chosen = chosen_recipe(recipe, {})
    style, logo = _template(template)
    folders = result_folders(results, library)
    from host_sync.report.writing import NO_BROWSER, find_browser, report_files

    browser = find_browser() if pdf else None
    with _output_folder(out):
        _check_free([out / NUMBERS_FILE, *(report_files(out / POPULATION) if population else ())], replace=overwrite)
        code = _report(
            measured(folders, chosen),
            style,
            logo,
            out,
            browser,
            population=population,
            overwrite=overwrite,
            semicolon=semicolon,
        )
    if pdf and browser is None:
        print_error(NO_BROWSER, PARTLY)
        return code or PARTLY
    return code


@contextmanager
def _output_folder(out: Path) -> Iterator[None]:
    """Makes the folder, and removes it where nothing was written to it."""
    try:
        is_new = not out.exists()
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ResultError(f"{out} cannot be written ({error.strerror}): choose another place") from error
    try:
        yield
    finally:
        if is_new:
            with suppress(OSError):
                out.rmdir()  # which refuses one that holds files


def _report(
    measurements: Iterable[Measurement | str],
    style: Template | None,
    logo: Picture | None,
    out: Path,
    browser: str | None,
    *,
    population: bool,
    overwrite: bool,
    semicolon: bool,
) -> int:
    """Write a report on each result or one on all, and their numbers; returns the exit code."""
    done: list[Measurement] = []
    failed = False
    taken: set[str] = set()
    for found in measurements:
        if isinstance(found, str):
            failed = True
            print_error(found, PARTLY)
            continue
        if not population:
            from host_sync.report.composing import compose

            name = file_name(found.record.scan_id or found.record.name, taken)
            try:
                _write(compose(found, style, logo), out / name, browser, replace=overwrite)
            except (DeviceError, HostError) as error:
                failed = True
                print_error(error, PARTLY)
                continue
        done.append(found.numbers_only())
        failed = failed or bool(found.failed) or found.fails
    if not done:
        return BAD_INPUT
    if population:
        from host_sync.report.population import compose_population

        failed = name_copies(done) or failed
        _write(compose_population(done, style, logo), out / POPULATION, browser, replace=overwrite)
    from host_sync.measurement.measurement import as_csv

    write_output(out / NUMBERS_FILE, as_csv(done, semicolon=semicolon).encode())
    return PARTLY if failed else DONE


def _write(report: Report, place: Path, browser: str | None, *, replace: bool) -> None:
    """Write a report's page and its PDF, and print where."""
    from host_sync.report.writing import report_files, write_report

    _check_free(report_files(place), replace=replace)
    for path in write_report(report, place, browser):
        print_line(str(path))


def _template(path: Path | None) -> tuple[Template | None, Picture | None]:
    """Return the template of a file and its logo, before minutes of work."""
    if path is None:
        return None, None
    from host_sync.report.writing import read_template

    return read_template(path)


def file_name(text: str, taken: set[str]) -> str:
    """Return a new file name from any text: letters, digits and . _ - only, not hidden; it is added to those taken."""
    plain = re.sub(r"[^A-Za-z0-9._-]+", "_", text).strip("._-")[:MAX_NAME] or "result"
    name, number = plain, 2
    while name.casefold() in taken:
        name, number = f"{plain}-{number}", number + 1
    taken.add(name.casefold())
    return name


def _check_free(places: Iterable[Path], *, replace: bool) -> None:
    """Refuse to replace existing files without --overwrite."""
    for path in places:
        if path.exists() and not replace:
            raise ResultError(f"{path} exists already: choose another folder, or --overwrite to replace it")
