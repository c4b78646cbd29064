"""What a report holds, apart from how it is set: facts, pictures, numbers, notes."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture and what it shows; PNG bytes, and its size in pixels (columns, rows)."""

    caption: str
    png: bytes
    size: tuple[int, int]


@dataclass(frozen=True, slots=True)
class Table:
    """Rows of texts under a head; `remarks` hold for every row."""

    title: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Report:
    """One result's report.

    title : its name
    operations : what was done to the surface before it was measured
    facts : label and value, in order
    warnings : what a reader must see first
    """

    title: str
    operations: str
    facts: tuple[tuple[str, str], ...]
    warnings: tuple[str, ...]
    pictures: tuple[Picture, ...]
    tables: tuple[Table, ...]
    notes: tuple[str, ...]
