"""One instrument of the demo, from its calibration to the errors of its scans."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.synchronize import Lock
from pathlib import Path

import cv2
import numpy as np

from device.acquisition.calibrate import calibrate
from device.acquisition.scanner import Scanner
from device.bundles.scan import Annotations
from device.imaging.flat_field import demosaic
from device.quick_look.solver import PICTURE_FILE
from device.store.store import BundleStore
from hal.board_profile import load_board_profile
from hal.clock import VirtualClock
from hal.interfaces import LiftOff, MayLift, PressObject
from hal.simulator.bench import TwinTruth, build
from hal.simulator.hardware import twin_hardware
from host_sync.integration.integrate import compile_integration
from host_sync.library.library import Library
from host_sync.offload.pull import pull
from host_sync.offload.source import DirectorySource
from host_sync.reconstruction.scans import LibraryReconstructor
from tests.demo.pictures import Chapter, summary_row, write_pictures
from tests.demo.programme import ACTS, BALL_RADIUS_MM, VERDICT, Act, Shown
from tests.demo.truth_judge import Judgement, judge


@dataclass(frozen=True, eq=False)
class Scanned:
    """A scan of the demo with its truth."""

    title: str
    scan_id: str
    truth: TwinTruth


def perform(
    act: Act, out: Path, one_at_a_time: Lock, report_progress: Callable[[str], None], *, compiles: bool
) -> list[Shown]:
    """One instrument from its calibration to the errors of its scans.

    one_at_a_time : held while the library is written
    report_progress : is given a few words as each step begins
    compiles : the solver's kernels first, which the other process would else compile too; the rest comes from that one
    """
    if compiles:
        report_progress("compile for this machine, only once")
        compile_integration()
    library = Library(out / "library")
    scanned, card = _play(act, out / "card" / act.board, report_progress)
    report_progress("pull from the card, every byte verified")
    with one_at_a_time:
        report = pull(DirectorySource(card), library)
    if report.failed:
        raise SystemExit(f"not pulled: {report.failed}")
    shown = _reconstruct(act, scanned, library, out, report_progress)
    report_progress("done")
    return shown


def _play(act: Act, card: Path, report_progress: Callable[[str], None]) -> tuple[list[Scanned], Path]:
    """Calibrate one instrument and scan its objects onto a card; the scans with their truth, and the card."""
    bench = build(load_board_profile(act.board), VirtualClock(time.monotonic_ns(), time.time()))
    scanned = []
    with twin_hardware(bench) as hardware:
        store = BundleStore(card, hardware.clock)
        calibrate(hardware, store, BALL_RADIUS_MM, lambda words: report_progress(f"calibrate: {words}"))
        hardware.operator.ask(LiftOff())
        hardware.button.wait_for_press(None)
        scanner = Scanner(hardware, store)
        scanner.measure_lights()
        for name in act.objects:
            report_progress(f"button scan: {name}")
            hardware.operator.ask(PressObject(name))
            hardware.button.wait_for_press(None)
            truth = bench.truth()
            outcome = scanner.scan(Annotations(job="demo", part=name), lambda: hardware.operator.ask(MayLift()))
            verdict = outcome.bundle.record.verdict
            report_progress(f"{VERDICT}{name}: {verdict.level}, {verdict.reason}")
            scanned.append(Scanned(f"{name}, {act.title}", outcome.bundle.scan_id, truth))
    return scanned, card


def _reconstruct(
    act: Act, scanned: list[Scanned], library: Library, out: Path, report_progress: Callable[[str], None]
) -> list[Shown]:
    """Full calibration and reconstruction of every scan, compared with the truth."""
    shown: list[Shown] = []
    job = LibraryReconstructor(library, report_progress=lambda words: report_progress(f"reconstruct: {words}"))
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
        report_progress(f"draw: {scan.title}")
        write_pictures(chapter, folder)
        first = act == ACTS[0] and not shown
        shown.append(Shown(scan.title, _figures(chapter.judgement), summary_row(chapter, titles=first)))
    return shown


def _figures(judgement: Judgement) -> tuple[str, ...]:
    shares = [judgement.within_deg(2.0), judgement.within_deg(4.0)]
    heights = [judgement.within_percent(2.0), judgement.within_percent(4.0)]
    return (
        f"{judgement.mean_angle_deg:.2f}°",
        *(_percent(share) for share in shares),
        f"{judgement.mean_height_um:.1f} µm",
        f"{judgement.mean_height_percent:.2f}%",
        *(_percent(share) for share in heights),
        _percent(judgement.sigma_covers),
    )


def _percent(share: float) -> str:
    """A fraction in percent with one decimal, never rounded up to a whole number."""
    return f"{int(1000.0 * share) / 10.0:.1f}"
