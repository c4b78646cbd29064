"""`retrosync reconstruct` and `retrosync paper-figures`."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, Literal

from cyclopts import Parameter
from cyclopts.validators import Number

from device.command_line import Folder, print_json
from device.io.atomic import check_output
from host_sync.batch.cluster import connected
from host_sync.batch.library_batch import ScanOutcome
from host_sync.cli.calibrate import calibrator_for
from host_sync.cli.console import (
    BAD_INPUT,
    DONE,
    PARTLY,
    announce_compiling,
    print_error,
    print_line,
    status_spinner,
)
from host_sync.cli.measure import chosen_recipe
from host_sync.errors import FrameSetError, HostError
from host_sync.filters.form import DetailBand
from host_sync.frames.frame_set import FrameSet, load_frame_set
from host_sync.library.library import Library, default_library
from host_sync.results.files import DetailName
from host_sync.text import some_of

if TYPE_CHECKING:
    from distributed import Client

    from device.bundles.scan import ScanBundle
    from host_sync.batch.library_watch import LibraryWatch


PictureFormat = Literal["png", "pdf", "svg"]
MethodName = Literal["direct", "paper"]
"""Methods of reconstruction; defined here too because importing them loads the numerics."""


@dataclass(frozen=True, slots=True)
class Order:
    """Options of a reconstruction; `facts` receives those of each calibration for JSON, None for lines."""

    method: MethodName | None
    band: DetailBand | None
    detail: DetailName
    force: bool
    facts: list[dict[str, object]] | None
    workers: int | None
    cluster: str | None


def reconstruct(
    *names: str,
    out: Folder | None = None,
    library: Folder | None = None,
    calibration: Path | None = None,
    method: Annotated[MethodName | None, Parameter(help="Default: the one with the smaller held-out error.")] = None,
    s_filter_um: float | None = None,
    l_filter_um: float | None = None,
    detail: DetailName = "shrunk",
    force: bool = False,
    workers: Annotated[int | None, Parameter(validator=Number(gte=1))] = None,
    cluster: str | None = None,
    json: bool = False,
    watch: bool = False,
    recipe: Path | None = None,
    every_s: Annotated[float, Parameter(validator=Number(gt=0, lte=MAX_EVERY_S))] = 5.0,
    once: bool = False,
) -> int:
    """Calibrate and reconstruct the scans of a FRAMESET.toml (with --out) or of a library (with --library).

    Parameters
    ----------
    names
        The frame set's file, then names of scans; or scans of the library. All scans by default.
    out
        Folder for the results of a frame set.
    library
        Folder of pulled scans; results go to SCAN/results/.
    calibration
        File that `retrosync calibrate` wrote. By default the frame set's presses, or each scan's own calibration, are
        used; a cache keeps the result.
    s_filter_um
        Also write the detail: nesting index of the Gaussian filter that removes shorter wavelengths.
    l_filter_um
        Also write the detail: nesting index of the Gaussian filter that removes longer wavelengths.
    detail
        Detail of heights, slopes and pictures: shrunk removes pixel noise, raw keeps it. The other
        height map is written too.
    force
        Also reconstruct scans that do not fit their calibration; result.json keeps the warning.
    workers
        Number of processes, each for one scan of a library at a time, with one thread. By default as many as there are
        cores, at most one for every 4 scans, and no more than fit into the available memory: one takes 0.4 GB and
        70 bytes a pixel (1.3 GB at 12 megapixels). 1 uses this process.
    cluster
        Address of a dask scheduler (tcp://HOST:8786), or its file: its workers, which share the library's folder with
        this computer, reconstruct the scans of the library. Needs the extra `cluster`; see docs/offload.md.
    json
        Print one JSON document instead of lines: calibrations, and the outcome of each scan.
    watch
        Reconstruct and measure new scans of the library, ~/Retrograph by default, until Ctrl-C. Measurements go to
        measurements/SCAN.json in it. Existing results are not repeated.
    recipe
        With --watch: TOML file of the measurement recipe.
    every_s
        With --watch: seconds from the end of a round of work to the next look for new scans; at most a day.
    once
        With --watch: do the work that there is now, and end; exit code 1 means that a scan failed.
    """
    band = None if s_filter_um is None and l_filter_um is None else DetailBand(s_filter_um, l_filter_um)
    order = Order(method, band, detail, force, [] if json else None, workers, cluster)
    if watch:
        plain = Order(None, None, "shrunk", force=False, facts=None, workers=workers, cluster=None)
        if out is not None or calibration is not None or order != plain or len(names) > (library is None):
            raise FrameSetError(
                "--watch is for a whole library, with --workers, --recipe, --every-s and --once alone: "
                "`reconstruct --library LIB --watch`"
            )
        return watch_library(library or (Path(names[0]) if names else None), recipe, workers, every_s, once=once)
    if recipe is not None or once:
        raise FrameSetError("--recipe and --once are for --watch: measure results with `retrosync measure`")
    if (out is None) == (library is None):
        raise FrameSetError("name either a frame set with --out DIR, or --library LIB")
    if library is None and workers is not None:
        raise FrameSetError("--workers is for the scans of a library: name it with --library LIB")
    if cluster is not None and (library is None or workers is not None):
        raise FrameSetError(
            "--cluster is for the scans of a library, and has workers of its own: use it with --library LIB"
        )
    with status_spinner() as report_progress:
        if library is not None:
            outcomes = _reconstruct_library(
                Library(library if cluster is None else library.resolve()), names, calibration, order, report_progress
            )
        elif not names or out is None:
            raise FrameSetError("name the frame set's file: retrosync reconstruct FRAMESET.toml --out DIR")
        else:
            frame_set = load_frame_set(Path(names[0]), calibrates=calibration is None)
            outcomes = _reconstruct_frame_set(frame_set, out, names[1:], calibration, order, report_progress)
    if json:
        print_json({"calibrations": order.facts, "scans": outcomes})
    failed = [outcome for outcome in outcomes if outcome.reason is not None]
    if failed and len(failed) == len(outcomes):
        return BAD_INPUT
    return PARTLY if failed else DONE


def _reconstruct_frame_set(
    frame_set: FrameSet,
    out: Path,
    names: Sequence[str],
    calibration: Path | None,
    order: Order,
    report_progress: Callable[[str], None],
) -> list[ScanOutcome]:
    check_output(out / "result.json", makes_folders=True)
    report_progress("loading compiled code")
    announce_compiling()
    from host_sync.reconstruction.scans import has_reference_of, reconstruct_frame_set

    calibrator = calibrator_for(calibration, report_progress, order.facts, paper=order.method == "paper")
    if calibration is not None and not has_reference_of(calibrator.named().calibration, frame_set):
        print_error(f"{frame_set.path}: [reference] differs from the calibration's, which is used instead", PARTLY)
    done, failures = reconstruct_frame_set(
        frame_set,
        out,
        order.method,
        names,
        report_progress,
        order.band,
        force=order.force,
        detail=order.detail,
        calibrator=calibrator,
    )
    outcomes = [ScanOutcome(name, out / name, doubts) for name, doubts in done.items()]
    outcomes += [ScanOutcome(failure.name, reason=failure.reason) for failure in failures]
    print_outcomes(outcomes)
    if order.facts is None:
        print_line(f"{len(done)} of {len(outcomes)} scans reconstructed into {out}")
    return outcomes


def _reconstruct_library(
    library: Library,
    names: Sequence[str],
    calibration: Path | None,
    order: Order,
    report_progress: Callable[[str], None],
) -> list[ScanOutcome]:
    listing = library.scans()
    named = [library.named(name) for name in names] if names else listing.bundles
    scans = list({scan.scan_id: scan for scan in named}.values())  # one by its id and its label is one
    damaged = () if names else listing.damaged
    failed = [ScanOutcome(bundle.directory.name, reason=bundle.reason) for bundle in damaged]
    if not scans and not failed:
        raise HostError(f"{library.root} holds no scans: pull some first")
    check_output(library.root / "scans" / "result.json")
    with nullcontext() if order.cluster is None else connected(order.cluster) as client:
        return _reconstruct_scans(library, scans, failed, calibration, order, client, report_progress)


def _reconstruct_scans(
    library: Library,
    scans: Sequence[ScanBundle],
    failed: list[ScanOutcome],
    calibration: Path | None,
    order: Order,
    client: Client | None,
    report_progress: Callable[[str], None],
) -> list[ScanOutcome]:
    report_progress("loading compiled code")
    announce_compiling()
    from host_sync.batch.library_batch import ReconstructionOptions, reconstruct_all, reconstruct_on_cluster
    from host_sync.reconstruction.scans import LibraryReconstructor

    calibrator = calibrator_for(calibration, report_progress, order.facts, paper=order.method == "paper")
    job = LibraryReconstructor(
        library,
        order.method,
        report_progress,
        order.band,
        force=order.force,
        detail=order.detail,
        calibrator=calibrator,
    )
    work = ReconstructionOptions(library.root, order.method, order.band, order.force, order.detail)
    if client is None:
        outcomes = reconstruct_all(scans, work, job, order.workers)
    else:
        outcomes = reconstruct_on_cluster(scans, work, job, client)
    done = []
    for number, outcome in enumerate(outcomes, start=1):
        report_progress(f"{number} of {len(scans)} scans")
        if outcome.reason is not None:
            failed.append(outcome)
            continue
        done.append(outcome)
        if order.facts is None:
            print_line(str(outcome.folder))
    done.sort(key=lambda one: one.scan)
    print_outcomes([*failed, *done])
    return [*done, *failed]


def print_outcomes(outcomes: Sequence[ScanOutcome]) -> None:
    """Print why scans failed, then every doubt once, with its scans."""
    scans_of: dict[str, list[str]] = {}
    for outcome in outcomes:
        if outcome.reason is not None:
            print_error(f"{outcome.scan}: {outcome.reason}", PARTLY)
        for words in outcome.warnings:
            scans_of.setdefault(words, []).append(outcome.scan)
    for words, scans in scans_of.items():
        print_error(f"{some_of(scans)}: doubt: {words}", PARTLY)


def paper_figures(
    name: str | None = None,
    /,
    *,
    out: Path,
    library: Path | None = None,
    calibration: Path | None = None,
    formats: Annotated[tuple[PictureFormat, ...], Parameter(name="--format", consume_multiple=True)] = ("png",),
) -> int:
    """Draw the figures of the CVPR 2009 paper: reflectance maps, ambiguous colours, errors of a held-out ball.

    Parameters
    ----------
    name
        The frame set's file; or, with --library, a calibration of it, the latest by default.
    out
        Folder for the pictures.
    library
        Folder of pulled calibrations.
    calibration
        File that `retrosync calibrate --paper` wrote from the same frames.
    formats
        Any of png, pdf, svg.
    """
    with status_spinner() as report_progress:
        report_progress("loading compiled code")
        announce_compiling()
        from host_sync.evaluation import frames_to_draw, write_figures

        calibrator = calibrator_for(calibration, report_progress, paper=True)
        frames, known = frames_to_draw(name, Library(library) if library is not None else None, calibrator)
        written = write_figures(frames, known, out, formats, report_progress)
    for path in written:
        sys.stdout.write(f"{path}\n")
    return DONE


# `retrosync reconstruct --watch`: reconstructs and measures whatever a pull brings.

MAX_EVERY_S: Final = 86_400.0
"""A day."""


def watch_library(library: Path | None, recipe: Path | None, workers: int | None, every_s: float, *, once: bool) -> int:
    """Reconstruct and measure whatever comes into a library, until it is stopped; returns the exit code.

    Arguments as of `retrosync reconstruct --watch`.
    """
    held = Library(library or default_library())
    held.require()
    chosen = chosen_recipe(recipe, {})
    with status_spinner() as report_progress:
        report_progress("loading compiled code")
        announce_compiling()
        from host_sync.batch.library_watch import LibraryWatch, only_watch
        from host_sync.reconstruction.scans import LibraryReconstructor

        job = LibraryReconstructor(
            held, report_progress=report_progress, calibrator=calibrator_for(None, report_progress)
        )
        watch = LibraryWatch(held, job, chosen, workers, report_progress)
        with only_watch(held):
            while True:
                failed = _look(watch)
                if once:
                    return PARTLY if failed else DONE
                report_progress("waiting for scans")
                time.sleep(every_s)


def _look(watch: LibraryWatch) -> bool:
    """Do what there is to do, with a line for every scan; returns whether one failed."""
    failed = False
    for outcome in watch.look():
        if outcome.reason is not None:
            failed = True
            print_error(f"{outcome.scan}: {outcome.reason}", PARTLY)
        else:
            print_line(f"{outcome.folder}")
        for words in outcome.warnings:
            print_error(f"{outcome.scan}: doubt: {words}", PARTLY)
        sys.stdout.flush()
    return failed
