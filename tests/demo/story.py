"""The whole workflow on the twin: calibrate, press the button, pull, reconstruct, and compare with the truth.

usage: python -m tests.demo.story --out demo-output

Each instrument has a process of its own. This one shows what they do: it loads nothing that computes, so that they
begin at once.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import time
from concurrent.futures import FIRST_EXCEPTION, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.queues import SimpleQueue
from multiprocessing.synchronize import Lock
from os.path import relpath
from pathlib import Path

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import Progress, TaskID, TextColumn, TimeElapsedColumn
from rich.table import Table

from host_sync.cli.main import raise_gc_threshold
from host_sync.kernels.cache import configure_cache, holds_kernels
from tests.demo.programme import ACTS, BALL_RADIUS_MM, VERDICT, Act, Shown


@dataclass(frozen=True)
class Stage:
    """What the processes of the demo share: steps to show, and the one library that one may write at a time."""

    steps: SimpleQueue[tuple[str, str]]
    library: Lock


STAGES: list[Stage] = []
"""The stage of this process, once it has begun."""


def main() -> int:
    """Run the demo; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("demo-output"), help="folder for pictures and data")
    out: Path = parser.parse_args().out
    console = Console()
    began_s = time.monotonic()
    shutil.rmtree(out, ignore_errors=True)
    context = get_context("spawn")
    stage = Stage(context.SimpleQueue(), context.Lock())
    columns = (TextColumn("{task.fields[title]:<12}"), TimeElapsedColumn(), TextColumn("{task.description}"))
    configure_cache()
    with (
        ProcessPoolExecutor(len(ACTS), context, _begin, (stage,)) as pool,
        Progress(*columns, console=console) as progress,
    ):
        compiling = None if holds_kernels() else ACTS[-1]
        acts = [pool.submit(_perform, act, out, compiles=act is compiling) for act in ACTS]
        tasks = {act.title: progress.add_task("", total=None, title=act.title) for act in ACTS}
        _show(stage, acts, tasks, progress)
        shown = [scan for act in acts for scan in act.result()]
    _write_summary(shown, out / "summary.png")
    console.print(_table(shown))
    console.print(f"{time.monotonic() - began_s:.0f} s in all. Scans, height maps and pictures are in {out}/.")
    console.print(f"Open this picture: {out / 'summary.png'}", soft_wrap=True)
    console.print(
        f"Look at the scans: {relpath(Path(sys.executable).with_name('retrosync'))} view {out}", soft_wrap=True
    )
    return 0


def _show(stage: Stage, acts: list[Future[list[Shown]]], tasks: dict[str, TaskID], progress: Progress) -> None:
    """Show the steps of every process until all have ended."""
    while stage.steps.empty() is False or not all(act.done() for act in acts):
        if stage.steps.empty():
            wait(acts, timeout=0.1, return_when=FIRST_EXCEPTION)
            if any(act.done() and act.exception() for act in acts):
                return
            continue
        title, words = stage.steps.get()
        progress.update(tasks[title], description=words)
        if words.startswith(VERDICT):
            progress.console.print(f"{title}: {words.removeprefix(VERDICT)}")


def _begin(stage: Stage) -> None:
    """Begin a process."""
    raise_gc_threshold()
    STAGES.append(stage)


def _perform(act: Act, out: Path, *, compiles: bool) -> list[Shown]:
    """Arguments and result as of `perform`; runs in a process of its own."""
    from tests.demo.act import perform  # here, because it loads all that computes

    (stage,) = STAGES
    return perform(act, out, stage.library, lambda words: stage.steps.put((act.title, words)), compiles=compiles)


def _write_summary(shown: list[Shown], path: Path) -> None:
    """Write the summary picture: one row per scan."""
    import cv2

    rows = cv2.vconcat([cv2.cvtColor(scan.row_rgb, cv2.COLOR_RGB2BGR) for scan in shown])
    if not cv2.imwrite(str(path), rows):
        raise SystemExit(f"{path} cannot be written")


def _table(shown: list[Shown]) -> Table:
    table = Table(
        title="Errors against the twin's truth, on contact pixels (inner 90 %)", box=SIMPLE_HEAD, padding=(0, 1, 0, 0)
    )
    table.add_column("scan", no_wrap=True)
    for name in ("normal", "<2°", "<4°", "height", "of R", "<2%", "<4%", "<σ"):
        table.add_column(name, justify="right", no_wrap=True)
    for scan in shown:
        table.add_row(scan.title, *scan.figures)
    table.caption = (
        "Mean error of normal and height, and percent of pixels within 2° and 4°, within 2 % and 4 % of the "
        f"calibration ball's radius R = {BALL_RADIUS_MM:g} mm, and within the stated standard uncertainty σ."
    )
    return table


if __name__ == "__main__":
    sys.exit(main())
