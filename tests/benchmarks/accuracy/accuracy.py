"""Measures every accuracy mark on real frames and on the twin, prints a table, and writes accuracy.json.

usage: python -m tests.benchmarks.accuracy.accuracy [--quick] [--out FILE]
       [--only real rendered twin resolution boards certificate]
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

import msgspec
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

from tests.benchmarks.accuracy.built_boards import built_figures
from tests.benchmarks.accuracy.check_standard import certificate_figures
from tests.benchmarks.accuracy.marks import Figures, all_marks, record
from tests.benchmarks.accuracy.measurements import real_figures, resolution_figures, twin_figures
from tests.benchmarks.accuracy.rendered_sets import rendered_figures

PARTS: Final = ("real", "rendered", "twin", "resolution", "boards", "certificate")


def main() -> int:
    """Measure, print and write; returns exit code 0 whether or not marks are met."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="fewer presses on the twin")
    parser.add_argument("--only", nargs="+", choices=PARTS, default=PARTS, help="leave the other parts unmeasured")
    parser.add_argument("--out", type=Path, default=Path("accuracy.json"), help="file for the record")
    arguments = parser.parse_args()
    console = Console()
    began_s = time.monotonic()
    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task("", total=None)
        figures = _measure(arguments.only, arguments.quick, lambda words: progress.update(task, description=words))
    arguments.out.write_bytes(msgspec.json.format(msgspec.json.encode(record(figures)), indent=2) + b"\n")
    console.print(_table(figures))
    met = sum(mark.met(figures.get(mark.name)) for mark in all_marks())
    console.print(f"{met} of {len(all_marks())} marks are met; {time.monotonic() - began_s:.0f} s; {arguments.out}")
    return 0


def _measure(parts: list[str], quick: bool, report_progress: Callable[[str], None]) -> Figures:
    """Figures of the named parts; result files are deleted."""
    figures: dict[str, float] = {}
    with tempfile.TemporaryDirectory(prefix="accuracy-") as name:
        folder = Path(name)
        if "real" in parts:
            figures |= real_figures(folder, report_progress)
        if "rendered" in parts:
            figures |= rendered_figures(folder, report_progress)
        if "twin" in parts:
            figures |= twin_figures(folder, report_progress, quick=quick)
        if "resolution" in parts:
            figures |= resolution_figures(folder, report_progress)
        if "boards" in parts:
            figures |= built_figures(folder, report_progress)
        if "certificate" in parts:
            figures |= certificate_figures(folder, report_progress)
    return figures


def _table(figures: Figures) -> Table:
    table = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0), caption="peer: a 5-32-32-32-2 network on (R, G, B, x, y)")
    table.add_column("figure", no_wrap=True)
    for heading in ("value", "mark", "peer", "met"):
        table.add_column(heading, justify="right", no_wrap=True)
    for mark in all_marks():
        value = figures.get(mark.name)
        shown = "not measured" if value is None else f"{value:.3f} {mark.unit}".rstrip()
        peer = "" if mark.peer is None else f"{mark.peer:g}"
        verdict = "-" if value is None else "yes" if mark.met(value) else "NO"
        table.add_row(mark.name, shown, mark.words, peer, verdict)
    return table


if __name__ == "__main__":
    sys.exit(main())
