"""Content of a report (facts, pictures, tables, notes), written as HTML, and as a PDF that a browser prints from it."""

from __future__ import annotations

import base64
import os
import re
import shutil
import subprocess
from dataclasses import dataclass
from html import escape as escape_markup
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Final, Literal

import cv2
import msgspec
import numpy as np

from device.io.atomic import write_output
from hal.validation import decode_toml, split_validation
from host_sync.errors import MeasurementError, ResultError
from host_sync.text import printable

VERDICT_HEAD: Final = "tolerance"
"""Head of the column whose cells begin with a verdict."""

VERDICTS: Final = ("pass", "fail", "undecided")


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture: caption, PNG bytes, and size in pixels (columns, rows); a sheet of many pictures takes a page."""

    caption: str
    png: bytes
    size: tuple[int, int]
    is_sheet: bool = False


@dataclass(frozen=True, slots=True)
class Table:
    """Rows of texts under a header; `remarks` concern all rows."""

    title: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    remarks: tuple[str, ...] = ()


SIGNED: Final = "SHA-256 of the report's words and numbers and its files' hashes, without pictures and logo"


@dataclass(frozen=True, slots=True)
class Report:
    """One result's report.

    title : its name
    head : lines above it, such as the organisation
    logo : beside the head
    verdict : pass, fail or undecided over all tolerances; empty without
    signature : SHA-256 of every word and number that the report prints and of the files' hashes, without pictures
    footer : at the foot of every page
    appendix : tables behind the numbers, such as the calibration
    operations : operations on the surface before the measurement
    facts : label and value, in order
    warnings : shown first
    """

    title: str
    operations: str
    facts: tuple[tuple[str, str], ...]
    warnings: tuple[str, ...]
    pictures: tuple[Picture, ...]
    tables: tuple[Table, ...]
    notes: tuple[str, ...]
    appendix: tuple[Table, ...] = ()
    head: tuple[str, ...] = ()
    logo: Picture | None = None
    verdict: str = ""
    signature: str = ""
    footer: str = ""


# A report's template: whose report it is, by whom, with what, and which parts it has; a TOML file.

Part = Literal["pictures", "numbers", "notes", "calibration", "provenance"]
Words = Annotated[str, msgspec.Meta(max_length=400)]

PARTS: Final[tuple[Part, ...]] = ("pictures", "numbers", "notes", "calibration", "provenance")
MAX_LOGO_BYTES: Final = 4_000_000
LOGO_PX: Final = (420, 140)
"""Largest columns and rows of a logo in a report."""


class Template(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The whole file.

    organisation, address : at the head of the report
    logo : picture (PNG, JPEG, WebP), relative to the template
    operator : who measured; else the scan's annotation
    instrument : what measured; else the scan's device
    procedure : which procedure or order this follows
    footer : at the foot of every page
    parts : which parts the report has, numbers at least
    """

    organisation: Words = ""
    address: Words = ""
    logo: Words = ""
    operator: Words = ""
    instrument: Words = ""
    procedure: Words = ""
    footer: Words = ""
    parts: tuple[Part, ...] = PARTS


def read_template(path: Path) -> tuple[Template, Picture | None]:
    """Return the template in a file, and its logo.

    Raises
    ------
    MeasurementError
        Names the file, the key, and what is accepted.
    """
    try:
        template = decode_toml(path.read_bytes(), Template)
    except OSError as error:
        raise MeasurementError(
            f"{path}: cannot be read ({error.strerror}): name a report's template in TOML"
        ) from error
    except msgspec.ValidationError as error:
        key, problem = split_validation(error)
        known = ", ".join(Template.__struct_fields__)
        raise MeasurementError(
            f"{path}: {key}: {problem}; accepted keys are {known}; parts: {', '.join(PARTS)}"
        ) from error
    except msgspec.DecodeError as error:
        raise MeasurementError(f"{path}: {error}") from error
    if "numbers" not in template.parts:
        raise MeasurementError(f"{path}: parts: a report has numbers: add them")
    return template, _logo(path.parent / template.logo) if template.logo else None


def _logo(path: Path) -> Picture:
    """Return a logo, reduced to its place."""
    try:
        data = path.read_bytes() if path.stat().st_size <= MAX_LOGO_BYTES else b""
    except OSError as error:
        raise MeasurementError(f"{path}: cannot be read ({error.strerror}): name the logo's file") from error
    pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) if data else None
    if pixels is None:
        raise MeasurementError(f"{path}: is no picture of at most {MAX_LOGO_BYTES >> 20} MB: name a PNG, JPEG or WebP")
    scale = min(LOGO_PX[0] / pixels.shape[1], LOGO_PX[1] / pixels.shape[0], 1.0)
    size = (max(1, round(pixels.shape[1] * scale)), max(1, round(pixels.shape[0] * scale)))
    _, png = cv2.imencode(".png", cv2.resize(pixels, size, interpolation=cv2.INTER_AREA))
    return Picture("Logo", png.tobytes(), size)


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
_NODE: Final = re.compile(rb"\(node\d{8}\)")


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
    """Return the HTML file and the PDF of a report."""
    return place.with_name(f"{place.name}.html"), place.with_name(f"{place.name}.pdf")


def _printed(page: Path, browser: str) -> bytes:
    """Return the PDF of a page; the same page gives the same bytes."""
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
    return _repeatable(data)


def _repeatable(sheet: bytes) -> bytes:
    """Return a PDF without its dates and with its elements numbered in order: a browser numbers them by chance."""
    numbers: dict[bytes, int] = {}
    dated = _NODE.sub(lambda found: b"(node%08d)" % numbers.setdefault(found[0], len(numbers)), sheet)
    return _DATE.sub(lambda found: b" " * len(found[0]), dated)


# A report as one self-contained HTML file without scripts, whose print style is that of the PDF.
#
# Every text is escaped, and a content policy forbids scripts and external resources as a second barrier.

_POLICY: Final = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"

_STYLE: Final = """
:root { color-scheme: light; }
body { font: 10.5pt/1.4 "Noto Sans", "DejaVu Sans", Arial, sans-serif; color: #1c1c1c; background: #fff;
  max-width: 52rem; margin: 2rem auto; padding: 0 1rem; overflow-wrap: anywhere; }
h1 { font-size: 1.6rem; margin-bottom: 0.2rem; } h2 { font-size: 1.1rem; margin: 1.6rem 0 0.4rem; }
table { border-collapse: collapse; width: 100%; font-size: 9.5pt; }
th, td { text-align: left; vertical-align: top; padding: 0.15rem 0.6rem 0.15rem 0; border-bottom: 1px solid #ddd; }
th { overflow-wrap: normal; }
td:nth-child(2) { font-variant-numeric: tabular-nums; }
.facts th { font-weight: normal; color: #555; width: 11rem; }
.hashes td:last-child { font-family: "DejaVu Sans Mono", monospace; font-size: 7.5pt; }
figure { margin: 1rem 0; break-inside: avoid; } img { max-width: 100%; height: auto; }
figcaption { color: #555; font-size: 9pt; }
.remark { font-size: 9pt; margin: 0.3rem 0; }
.warning { border-left: 4px solid #b03020; padding: 0.3rem 0.8rem; background: #fbeeec; }
.head { display: flex; gap: 1rem; align-items: center; border-bottom: 1px solid #ddd; padding-bottom: 0.6rem; }
.head p { margin: 0; } .verdict { font-weight: 600; } p.verdict { padding: 0.3rem 0.8rem; border-left: 4px solid; }
.pass { color: #1d5d33; } .fail { color: #8c2f1b; } .undecided { color: #7a4a00; }
.signature code { font-size: 7.5pt; }
tr { break-inside: avoid; } h2 { break-after: avoid; }
@media print {
  body { margin: 0; padding: 0; max-width: none; font-size: 8.5pt; } h1 { font-size: 15pt; } h2 { font-size: 10pt; }
  table, .remark, figcaption { font-size: 7.5pt; } .footer { display: none; }
  img { width: auto; max-height: 120mm; } img.sheet { max-height: 230mm; }
  .hashes td:last-child, .signature code { font-size: 5.6pt; }
}
"""
_PAGE: Final = """@page { size: A4; margin: 14mm 15mm 16mm; color: #555;
  font: 7pt "Noto Sans", "DejaVu Sans", Arial, sans-serif;
  @bottom-left { content: "%s"; width: 85%%; }
  @bottom-right { content: "page " counter(page); }
}
"""


def html_page(report: Report) -> str:
    """Return the page; at the foot of a printed one stands the template's line, else the beginning of the title."""
    foot = printable(report.footer or report.title)[:110]
    body = _head(report)
    body += [f"<h1>{escape(report.title)}</h1>", f"<p>{escape(report.operations)}</p>"]
    body += [f'<p class="warning">Warning: {escape(warning)}</p>' for warning in report.warnings]
    if report.verdict:
        body.append(f'<p class="verdict {report.verdict}">Tolerances: {escape(report.verdict)}</p>')
    body.append(_facts(report.facts))
    body += [_figure(picture) for picture in report.pictures[:1]]
    body += [_table(table) for table in report.tables]
    if report.notes:
        body.append(_list(report.notes))
    body += [_figure(picture) for picture in report.pictures[1:]]
    body += [_table(table, "hashes" if len(table.head) == 3 else "") for table in report.appendix]
    if report.signature:
        body.append(f'<p class="signature">{SIGNED}: <code>{escape(report.signature)}</code></p>')
    if report.footer:
        body.append(f'<p class="remark footer">{escape(report.footer)}</p>')
    return "\n".join(
        [
            '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">',
            f'<meta http-equiv="Content-Security-Policy" content="{escape(_POLICY)}">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            f"<title>{escape(report.title)}</title>\n<style>{_STYLE}{_PAGE % _in_style(foot)}</style>\n</head>\n<body>",
            *body,
            "</body>\n</html>\n",
        ]
    )


def escape(text: str) -> str:
    """Return the text with markup escaped."""
    return escape_markup(printable(text))


def _in_style(text: str) -> str:
    """Return a text between quotation marks of a style sheet, where every sign but letters and digits is a number."""
    return "".join(letter if letter.isalnum() else f"\\{ord(letter):x} " for letter in text)


def _head(report: Report) -> list[str]:
    """Return the logo and organisation."""
    if report.logo is None and not report.head:
        return []
    logo = ""
    if report.logo is not None:
        data = base64.b64encode(report.logo.png).decode("ascii")
        logo = f'<img src="data:image/png;base64,{data}" width="{report.logo.size[0] // 2}" alt="">'
    words = "".join(f"<p>{escape(line)}</p>" for line in report.head)
    return [f'<header class="head">{logo}<div>{words}</div></header>']


def _cell(head: str, cell: str) -> str:
    verdict = cell.partition(":")[0]
    kind = f' class="verdict {verdict}"' if head == VERDICT_HEAD and verdict in VERDICTS else ""
    return f"<td{kind}>{escape(cell)}</td>"


def _facts(facts: tuple[tuple[str, str], ...]) -> str:
    rows = "\n".join(f'<tr><th scope="row">{escape(label)}</th><td>{escape(value)}</td></tr>' for label, value in facts)
    return f'<table class="facts">\n{rows}\n</table>'


def _figure(picture: Picture) -> str:
    data = base64.b64encode(picture.png).decode("ascii")
    words = escape(picture.caption)
    columns, rows = picture.size
    kind = ' class="sheet"' if picture.is_sheet else ""
    image = f'<img{kind} src="data:image/png;base64,{data}" width="{columns}" height="{rows}" alt="{words}">'
    return f"<figure>\n{image}\n<figcaption>{words}</figcaption>\n</figure>"


def _table(table: Table, kind: str = "") -> str:
    head = "".join(f'<th scope="col">{escape(cell)}</th>' for cell in table.head)
    rows = "\n".join("<tr>" + "".join(map(_cell, table.head, row)) + "</tr>" for row in table.rows)
    name = f' class="{kind}"' if kind else ""
    title = f"<h2>{escape(table.title)}</h2>\n<table{name}>\n<thead><tr>{head}</tr></thead>"
    remarks = "".join(f'<p class="remark">{escape(remark)}</p>' for remark in table.remarks)
    return f"{title}\n<tbody>\n{rows}\n</tbody>\n</table>{remarks}"


def _list(notes: tuple[str, ...]) -> str:
    return "<ul>\n" + "\n".join(f"<li>{escape(note)}</li>" for note in notes) + "\n</ul>"
