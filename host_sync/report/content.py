"""Content of a report, independent of its layout: facts, pictures, tables, notes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

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
