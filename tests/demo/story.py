"""The whole workflow on the twin: calibrate, press the button, pull, reconstruct, and compare with the truth.

usage: python -m tests.demo.story --out demo-output
"""

from __future__ import annotations

import argparse
import shutil
import sys
import time
from collections.abc import Callable
from concurrent.futures import FIRST_EXCEPTION, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.queues import SimpleQueue
from multiprocessing.synchronize import Lock
from pathlib import Path

import cv2
import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import Progress, TaskID, TextColumn, TimeElapsedColumn
from rich.table import Table

from device.acquisition.calibrate import calibrate
from device.acquisition.scanner import Scanner
from device.bundles.scan import Annotations
from device.imaging.flat_field import demosaic
from device.quick_look.files import PICTURE_FILE
from device.store.store import BundleStore
from hal.board_profile import load_board_profile
from hal.clock import VirtualClock
from hal.interfaces import LiftOff, MayLift, PressObject
from hal.simulator.bench import TwinTruth, build
from hal.simulator.hardware import twin_hardware
from host_sync.integration.compile_ahead import compile_integration
from host_sync.kernels.cache import holds_kernels
from host_sync.library.library import Library
from host_sync.offload.directory import DirectorySource
from host_sync.offload.pull import pull
from host_sync.reconstruction.from_library import LibraryReconstructor
from tests.demo.pictures import Chapter, write_pictures, write_summary
from tests.demo.truth_judge import Judgement, judge

BALL_RADIUS_MM = 3.0
VERDICT = "verdict: "


@dataclass(frozen=True)
class Act:
    """One instrument of the demo, the distance of its lights, and what is pressed on it."""

    board: str
    title: str
    objects: tuple[str, ...]


ACTS = (
    Act("twin", "25 mm", ("sphere", "coin", "texture")),
    Act("twin-distant", "250 mm", ("sphere",)),
)


@dataclass(frozen=True, eq=False)
class Scanned:
    """A scan of the demo with its truth."""

    title: str
    scan_id: str
    truth: TwinTruth


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
    with (
        ProcessPoolExecutor(len(ACTS), context, _begin, (stage,)) as pool,
        Progress(*columns, console=console) as progress,
    ):
        compiling = None if holds_kernels() else ACTS[-1]
        acts = [pool.submit(_perform, act, out, compiles=act is compiling) for act in ACTS]
        tasks = {act.title: progress.add_task("", total=None, title=act.title) for act in ACTS}
        _show(stage, acts, tasks, progress)
        chapters = [chapter for act in acts for chapter in act.result()]
    write_summary(chapters, out / "summary.png")
    console.print(_table(chapters))
    console.print(f"{time.monotonic() - began_s:.0f} s in all. Scans, height maps and pictures are in {out}/.")
    console.print(f"Open this picture: {out / 'summary.png'}", soft_wrap=True)
    return 0


def _show(stage: Stage, acts: list[Future[list[Chapter]]], tasks: dict[str, TaskID], progress: Progress) -> None:
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
    STAGES.append(stage)


def _perform(act: Act, out: Path, *, compiles: bool) -> list[Chapter]:
    """One instrument from its calibration to the errors of its scans; runs in a process of its own.

    compiles : the solver's kernels first, which the other process would else compile too; the rest comes from that one
    """
    (stage,) = STAGES

    def tell(words: str) -> None:
        stage.steps.put((act.title, words))

    if compiles:
        tell("compile for this machine, only once")
        compile_integration()
    library = Library(out / "library")
    scanned, card = _play(act, out / "card" / act.board, tell)
    tell("pull from the card, every byte verified")
    with stage.library:
        report = pull(DirectorySource(card), library)
    if report.failed:
        raise SystemExit(f"not pulled: {report.failed}")
    chapters = _reconstruct(scanned, library, out, tell)
    tell("done")
    return chapters


def _play(act: Act, card: Path, tell: Callable[[str], None]) -> tuple[list[Scanned], Path]:
    """Calibrate one instrument and scan its objects onto a card; the scans with their truth, and the card."""
    bench = build(load_board_profile(act.board), VirtualClock(time.monotonic_ns(), time.time()))
    scanned = []
    with twin_hardware(bench) as hardware:
        store = BundleStore(card, hardware.clock)
        calibrate(hardware, store, BALL_RADIUS_MM, lambda words: tell(f"calibrate: {words}"))
        hardware.operator.ask(LiftOff())
        hardware.button.wait_for_press(None)
        scanner = Scanner(hardware, store)
        scanner.measure_lights()
        for name in act.objects:
            tell(f"button scan: {name}")
            hardware.operator.ask(PressObject(name))
            hardware.button.wait_for_press(None)
            truth = bench.truth()
            outcome = scanner.scan(Annotations(job="demo", part=name), lambda: hardware.operator.ask(MayLift()))
            verdict = outcome.bundle.record.verdict
            tell(f"{VERDICT}{name}: {verdict.level}, {verdict.reason}")
            scanned.append(Scanned(f"{name}, {act.title}", outcome.bundle.scan_id, truth))
    return scanned, card


def _reconstruct(scanned: list[Scanned], library: Library, out: Path, tell: Callable[[str], None]) -> list[Chapter]:
    """Full calibration and reconstruction of every scan, compared with the truth."""
    chapters = []
    job = LibraryReconstructor(library, tell=lambda words: tell(f"reconstruct: {words}"))
    for scan in scanned:
        bundle = library.find(scan.scan_id)
        reconstruction, _ = job.run(bundle)
        chapter = Chapter(
            title=scan.title,
            frame_rgb=demosaic(bundle.raw_frame()).rgb,
            quick_look=np.asarray(cv2.imread(str(bundle.path(PICTURE_FILE)), cv2.IMREAD_GRAYSCALE), np.uint8),
            height=reconstruction.height,
            judgement=judge(reconstruction, scan.truth, BALL_RADIUS_MM * 1e3),
        )
        folder = out / scan.title.replace(", ", "-").replace(" ", "-")
        folder.mkdir(parents=True)
        tell(f"draw: {scan.title}")
        write_pictures(chapter, folder)
        chapters.append(chapter)
    return chapters


def _table(chapters: list[Chapter]) -> Table:
    table = Table(
        title="Errors against the twin's truth, on contact pixels (inner 90 %)", box=SIMPLE_HEAD, padding=(0, 1, 0, 0)
    )
    table.add_column("scan", no_wrap=True)
    for name in ("normal", "<2°", "<4°", "height", "of R", "<2%", "<4%", "<σ"):
        table.add_column(name, justify="right", no_wrap=True)
    for chapter in chapters:
        table.add_row(chapter.title, *_figures(chapter.judgement))
    table.caption = (
        "Mean error of normal and height, and percent of pixels within 2° and 4°, within 2 % and 4 % of the "
        f"calibration ball's radius R = {BALL_RADIUS_MM:g} mm, and within the stated standard uncertainty σ."
    )
    return table


def _figures(judgement: Judgement) -> list[str]:
    shares = [judgement.within_deg(2.0), judgement.within_deg(4.0)]
    heights = [judgement.within_percent(2.0), judgement.within_percent(4.0)]
    return [
        f"{judgement.mean_angle_deg:.2f}°",
        *(_percent(share) for share in shares),
        f"{judgement.mean_height_um:.1f} µm",
        f"{judgement.mean_height_percent:.2f}%",
        *(_percent(share) for share in heights),
        _percent(judgement.sigma_covers),
    ]


def _percent(share: float) -> str:
    """A fraction in percent with one decimal, never rounded up to a whole number."""
    return f"{int(1000.0 * share) / 10.0:.1f}"


if __name__ == "__main__":
    sys.exit(main())
