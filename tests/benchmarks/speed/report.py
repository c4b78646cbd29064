"""The table for people, and the file for programs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import msgspec
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

VERDICTS = {True: "met", False: "not met", None: "undecided"}
STYLES = {"met": "green", "not met": "red", "undecided": ""}
COLUMNS = ("min_ms", "median_ms", "first_ms", "rmse_px", "stages_ms")
FIGURE_TITLES = ("", "ms, min", "median", "first", "error, px", "")
MARK_TITLES = ("mark", "what", "value", "limit", "")
SIGNS = {"at least": "≥", "at most": "≤"}


def write_json(path: Path, report: Mapping[str, Any]) -> None:
    """Write marks, figures and machine."""
    path.write_bytes(msgspec.json.format(msgspec.json.encode(report), indent=2) + b"\n")


def show(console: Console, report: Mapping[str, Any]) -> None:
    """Print every figure, then every mark."""
    console.print(_figures(report["figures"]))
    console.print(_marks(report["marks"]))
    facts = report["machine"]
    console.print(
        f"{facts['processor']}, {facts['cores']} cores, {facts['memory_gb']:.0f} GB, "
        f"load {facts['load_average_1_min']:.1f} at the start. "
        "Times are of runs in turns: trust ratios, not times, on a shared machine.",
        soft_wrap=True,
    )
    if facts["quick"]:
        console.print("This was --quick: its sizes are too small for any mark to mean anything.")


def figure_rows(part: Mapping[str, Any], depth: int = 0) -> Iterator[tuple[str, ...]]:
    """Label, three times, error and remarks of every figure as text; nested figures are indented."""
    for name, inner in part.items():
        label = "  " * depth + name
        if not isinstance(inner, Mapping):
            yield label, "", "", "", "", _text(inner)
            continue
        plain = {k: v for k, v in inner.items() if k not in COLUMNS and not isinstance(v, Mapping)}
        more = ", ".join(f"{k.replace('_', ' ')} {_text(v)}" for k, v in plain.items() if k != "runs")
        error_px = inner.get("rmse_px")
        times = (_text(inner.get(key)) for key in COLUMNS[:3])
        yield label, *times, "" if error_px is None else f"{error_px:.4f}", more
        for stage, stage_ms in inner.get("stages_ms", {}).items():
            yield "  " * (depth + 1) + stage, _text(stage_ms), "", "", "", ""
        yield from figure_rows(
            {k: v for k, v in inner.items() if isinstance(v, Mapping) and k != "stages_ms"}, depth + 1
        )


def mark_rows(marks: Mapping[str, Mapping[str, Any]]) -> Iterator[tuple[str, ...]]:
    """Item, words, value, limit and verdict of every mark as text."""
    for mark in marks.values():
        limit = f"{SIGNS[mark['sense']]} {_text(mark['mark'])}"
        yield str(mark["item"]), mark["words"], _text(mark["value"]) or "-", limit, VERDICTS[mark["met"]]


def _figures(figures: Mapping[str, Any]) -> Table:
    table = Table(title="Figures", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column("", no_wrap=True)
    for name in FIGURE_TITLES[1:-1]:
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("")
    for section, part in figures.items():
        table.add_row(Text(section, style="bold"))
        for row in figure_rows(part, depth=1):
            table.add_row(*row)
    return table


def _marks(marks: Mapping[str, Mapping[str, Any]]) -> Table:
    table = Table(title="Marks", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column(MARK_TITLES[0], justify="right")
    table.add_column(MARK_TITLES[1])
    for name in MARK_TITLES[2:]:
        table.add_column(name, justify="right", no_wrap=True)
    for row in mark_rows(marks):
        table.add_row(*row[:-1], Text(row[-1], style=STYLES[row[-1]]))
    return table


def _text(value: Any) -> str:
    """A figure with three significant digits; empty for None."""
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:.0f}" if abs(value) >= 100.0 else f"{value:.3g}"
    return str(value)
