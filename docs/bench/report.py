"""The one table that people read, and the file that programs read."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

VERDICTS = {True: "[green]met[/]", False: "[red]not met[/]", None: "cannot be told"}
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


def _figures(figures: Mapping[str, Any]) -> Table:
    table = Table(title="Figures", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column("", no_wrap=True)
    for name in ("ms, min", "median", "first", "error, px"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("")
    for section, part in figures.items():
        table.add_row(f"[bold]{section}[/]")
        for name, inner in part.items():
            _add_rows(table, f"  {name}", inner)
    return table


def _add_rows(table: Table, label: str, part: Any) -> None:
    """A row for what was timed or is one figure; for what holds more of them, a row each, further in."""
    if not isinstance(part, Mapping):
        table.add_row(label, "", "", "", "", _text(part))
        return
    known = {"min_ms", "median_ms", "first_ms", "rmse_px", "runs", "stages_ms"}
    times = (_text(part.get(key)) for key in ("min_ms", "median_ms", "first_ms"))
    error_px = part.get("rmse_px")
    plain = {key: value for key, value in part.items() if key not in known and not isinstance(value, Mapping)}
    more = ", ".join(f"{key} {_text(value)}" for key, value in plain.items())
    table.add_row(label, *times, "" if error_px is None else f"{error_px:.4f}", more)
    for stage, stage_ms in part.get("stages_ms", {}).items():
        table.add_row(f"    {stage}", _text(stage_ms))
    for name, inner in part.items():
        if name not in known and name not in plain:
            _add_rows(table, " " * (len(label) - len(label.lstrip()) + 2) + name, inner)


def _marks(marks: Mapping[str, Mapping[str, Any]]) -> Table:
    table = Table(title="Marks", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column("mark", justify="right")
    table.add_column("what")
    for name in ("value", "limit", ""):
        table.add_column(name, justify="right", no_wrap=True)
    for mark in marks.values():
        value, limit = _text(mark["value"]), f"{SIGNS[mark['sense']]} {_text(mark['mark'])}"
        table.add_row(str(mark["item"]), mark["words"], value or "-", limit, VERDICTS[mark["met"]])
    return table


def _text(value: Any) -> str:
    """A figure with three significant digits; nothing for None."""
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:.0f}" if abs(value) >= 100.0 else f"{value:.3g}"
    return str(value)
