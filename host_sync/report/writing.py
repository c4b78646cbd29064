"""Writes a report as HTML, and as a PDF that a browser prints from it."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from device.io.atomic import write_output
from host_sync.errors import ResultError
from host_sync.report.content import Report
from host_sync.report.html_page import html_page

NO_BROWSER: Final = (
    "no PDF is written, because Chromium, Chrome and Edge are missing: install one of them, or print the HTML file"
)
MAX_PRINTING_S: Final = 300.0
_PROGRAMS: Final = (
    "chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "microsoft-edge", "microsoft-edge-stable",
    "brave-browser", "chrome", "msedge",
)  # fmt: skip
_PLACES: Final = (
    "${PROGRAMFILES}/Google/Chrome/Application/chrome.exe",
    "${PROGRAMFILES(X86)}/Microsoft/Edge/Application/msedge.exe",
    "/Applications/Google Chrome.app/Contents/MacOS/Google Chrome",
    "/Applications/Chromium.app/Contents/MacOS/Chromium",
    "/Applications/Microsoft Edge.app/Contents/MacOS/Microsoft Edge",
)
_DATE: Final = re.compile(rb"/(?:Creation|Mod)Date \(D:[^)]*\)")


def find_browser() -> str | None:
    """Return the path of a browser that prints pages without a window, or None."""
    named = (shutil.which(program) for program in _PROGRAMS)
    placed = (os.path.expandvars(place) for place in _PLACES)
    return next((path for path in (*named, *placed) if path and Path(path).is_file()), None)


def write_report(report: Report, place: Path, browser: str | None) -> list[Path]:
    """Write a report and return its files: `place` with .html, and with .pdf where there is a browser.

    Raises
    ------
    OutputError, ResultError
        A file cannot be written, or the browser does not print.
    """
    page, sheet = report_files(place)
    write_output(page, html_page(report).encode())
    sheet.unlink(missing_ok=True)  # of the report that this one replaces
    if browser is None:
        return [page]
    write_output(sheet, _printed(page, browser))
    return [page, sheet]


def report_files(place: Path) -> tuple[Path, Path]:
    """The HTML file and the PDF of a report."""
    return place.with_name(f"{place.name}.html"), place.with_name(f"{place.name}.pdf")


def _printed(page: Path, browser: str) -> bytes:
    """The PDF of a page without its dates: the same page gives the same bytes."""
    sheet = page.with_name(f".{page.name}.partial")  # beside the page: a packaged browser may have a /tmp of its own
    with TemporaryDirectory(prefix="retrograph-", ignore_cleanup_errors=True) as profile:
        # Without a sandbox, which containers refuse: the page has no scripts, and its pictures were encoded here.
        options = ["--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", f"--user-data-dir={profile}"]
        printing = ["--no-pdf-header-footer", f"--print-to-pdf={sheet.absolute()}", page.absolute().as_uri()]
        try:
            subprocess.run(  # noqa: S603 - no shell
                [browser, *options, *printing], check=True, capture_output=True, timeout=MAX_PRINTING_S
            )
            data = sheet.read_bytes()
        except (OSError, subprocess.SubprocessError) as error:
            raise ResultError(f"{page} is written, but {browser} makes no PDF of it: print it from a window") from error
        finally:
            sheet.unlink(missing_ok=True)
    return _DATE.sub(lambda found: b" " * len(found[0]), data)
