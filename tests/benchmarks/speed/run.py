"""`make bench`: our methods and their peers side by side on this machine, in one table and in bench.json.

usage: python -m tests.benchmarks.speed.run [--quick] [--only SECTION ...] [--out bench.json]

Imports are inside functions: processes started by the benchmark read this file and must load only what they measure.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tests.benchmarks.speed.plan import Plan

FILE_COLUMNS = 110
"""Width of the tables where no terminal states one."""

SECTIONS = ["handheld", "one press", "integration", "gradients", "video", "pipeline", "two workers", "memory", "lights"]
WITHOUT_FRAMES = {"one press", "integration", "memory", "lights"}


def main() -> int:
    """Run every section; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="tiny sizes, seconds: shows only that everything runs")
    parser.add_argument("--out", type=Path, help="file to write; bench.json, and nowhere with --quick, when not given")
    parser.add_argument(
        "--only",
        nargs="+",
        choices=SECTIONS,
        default=SECTIONS,
        metavar="SECTION",
        help=f"some of {', '.join(SECTIONS)}",
    )
    options = parser.parse_args()
    from rich.console import Console

    from tests.benchmarks.speed.machine import machine_facts
    from tests.benchmarks.speed.marks import judge
    from tests.benchmarks.speed.plan import FULL, QUICK
    from tests.benchmarks.speed.report import show, write_json

    console = Console() if sys.stdout.isatty() else Console(width=FILE_COLUMNS)
    facts = machine_facts() | {"quick": options.quick}
    with console.status("") as status, tempfile.TemporaryDirectory(prefix="retrograph-bench-") as folder:
        figures = measure(QUICK if options.quick else FULL, options.only, Path(folder), status.update)
    report = {"marks": judge(figures), "figures": figures, "machine": facts}
    show(console, report)
    out = options.out or (None if options.quick else Path("bench.json"))
    if out:
        write_json(out, report)
        console.print(f"Every figure is in {out}.", soft_wrap=True)
    return 0


def measure(plan: Plan, only: list[str], folder: Path, report_progress: Callable[[str], None]) -> dict[str, Any]:
    """Figures of the sections by name."""
    from tests.benchmarks.speed import (
        gradients,
        handheld,
        integration,
        lights,
        memory,
        one_press,
        pipeline,
        two_workers,
        video,
    )
    from tests.benchmarks.speed.fresh import fresh
    from tests.benchmarks.speed.specimen import at_size, field_calibration, render

    figures: dict[str, Any] = {"sizes": _sizes(plan)}
    if set(only) - WITHOUT_FRAMES:
        report_progress("calibrating the twin and taking frames of every size")
        calibration = field_calibration(plan.calibrated, plan.presses, folder / "store")
        maps = {shape: at_size(calibration.inverse.map, shape) for shape in plan.handheld}
        for shape in sorted({*plan.scans, *plan.handheld}):
            fresh(render, shape, folder)
    sections: dict[str, Callable[[], dict[str, Any]]] = {
        "handheld": lambda: handheld.measure(plan, maps, folder, report_progress),
        "one press": lambda: one_press.measure(plan, folder, report_progress),
        "integration": lambda: integration.measure(plan, report_progress),
        "gradients": lambda: gradients.measure(plan, calibration, report_progress),
        "video": lambda: video.measure(plan, calibration, folder, report_progress),
        "pipeline": lambda: pipeline.measure(plan, calibration, folder, report_progress),
        "two workers": lambda: two_workers.measure(plan, calibration, folder, report_progress),
        "memory": lambda: memory.measure(plan, report_progress),
        "lights": lambda: lights.measure(plan, report_progress),
    }
    return figures | {name: sections[name]() for name in only}


def _sizes(plan: Plan) -> dict[str, Any]:
    from tests.benchmarks.speed.plan import named

    large, small = plan.large[0] * plan.large[1], plan.small[0] * plan.small[1]
    return {"large": named(plan.large), "small": named(plan.small), "large_over_small": large / small}


if __name__ == "__main__":
    sys.exit(main())
