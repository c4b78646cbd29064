"""Content of a report, independent of its layout: facts, pictures, tables, notes."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture: caption, PNG bytes, and size in pixels (columns, rows)."""

    caption: str
    png: bytes
    size: tuple[int, int]


@dataclass(frozen=True, slots=True)
class Table:
    """Rows of texts under a header; `remarks` concern all rows; `widths` are fractions of the page width per column."""

    title: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    remarks: tuple[str, ...] = ()
    widths: tuple[float, ...] | None = None


@dataclass(frozen=True, slots=True)
class Report:
    """One result's report.

    title : its name
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
