"""Writes the figures of a bench.json into docs/performance.md, between its two marker lines.

usage: python -m tests.benchmarks.speed.tables bench.json [more.json ...] docs/performance.md

Files of `--only` runs are combined: later ones replace sections of earlier ones.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import msgspec

from tests.benchmarks.speed.marks import judge
from tests.benchmarks.speed.report import FIGURE_TITLES, MARK_TITLES, figure_rows, mark_rows

BEGIN, END = "<!-- figures: written by tests/benchmarks/speed/tables.py -->", "<!-- end of figures -->"


def main(arguments: Sequence[str]) -> int:
    """Rewrite the document; returns the exit code."""
    if len(arguments) < 2:
        sys.stderr.write(f"{__doc__}\n")
        return 2
    *sources, target = (Path(argument) for argument in arguments)
    document = target.read_text(encoding="utf-8")
    before, begin, rest = document.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        sys.stderr.write(f"{target} lacks the lines {BEGIN} and {END}: put them where the figures belong\n")
        return 2
    reports = [msgspec.json.decode(source.read_bytes()) for source in sources]
    figures = {name: part for report in reports for name, part in report["figures"].items()}
    words = "\n\n".join(_sections(figures, reports[-1]["machine"]))
    target.write_text(f"{before}{BEGIN}\n\n{words}\n\n{END}{after}", encoding="utf-8")
    return 0


def _sections(figures: dict[str, Any], machine: dict[str, Any]) -> Iterable[str]:
    versions = ", ".join(f"{name} {version}" for name, version in machine["versions"].items() if version)
    yield (
        f"{machine['processor']}, {machine['cores']} cores, {machine['memory_gb']:.0f} GB, Python {machine['python']}, "
        f"{versions}; load {machine['load_average_1_min']:.1f} at the start."
    )
    yield "### Marks"
    yield _table(MARK_TITLES, mark_rows(judge(figures)))
    for name, part in figures.items():
        if name != "sizes":
            yield f"### {name.capitalize()}"
            yield _table(FIGURE_TITLES, figure_rows(part))


def _table(titles: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table; indentation becomes hard spaces."""
    lines = [titles, ["---"] * len(titles), *([row[0].replace("  ", "&emsp;"), *row[1:]] for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
