"""Streams and series of `host_sync.api`: many images under one calibration."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any

from device.errors import DeviceError
from host_sync.api_arguments import check_workers
from host_sync.api_types import HeightFrame, HeightStream
from host_sync.calibration_file.kept_calibration import KeptCalibration
from host_sync.errors import HostError
from host_sync.integration.zero_level import NO_ZERO
from host_sync.kernels.jit import get_num_threads, set_num_threads
from host_sync.video.frame_solver import FrameSolver
from host_sync.video.live import LiveHeights, open_live
from host_sync.video.stream import SolvedFrame, in_order

if TYPE_CHECKING:
    from host_sync.api_types import Encoding, Image, Method, Result


def reconstructed_in_order(
    reconstruct: Callable[[Image], Result], images: Iterable[Image], workers: int | None
) -> Iterator[Result | HostError | DeviceError]:
    """Yield what `reconstruct` returns of every image, or the error that it raises, a thread for each worker."""

    def guarded(image: Image) -> Result | HostError | DeviceError:
        try:
            return reconstruct(image)
        except (HostError, DeviceError) as error:
            return error

    workers = check_workers(workers)
    threads = -(-get_num_threads() // workers)
    with ThreadPoolExecutor(workers, "images", set_num_threads, (threads,)) as executor:
        yield from in_order((executor.submit(guarded, image) for image in images), workers)


def open_stream(
    source: Any, calibration: KeptCalibration, kept: str | None, sigma: bool, encoding: Encoding | None,
    full_scale: int | None, method: Method | None, force: bool,
) -> HeightStream:  # fmt: skip
    """Return the stream of a source; arguments as of `host_sync.api.stream`, checked."""
    solver = FrameSolver.of(calibration, method, encoding, full_scale=full_scale, force=force)
    live = open_live(source, solver, newest=None if kept is None else kept == "newest", sigma=sigma)
    return HeightStream(
        (_height_frame(one, live, solver.pitch_um) for one in live),
        solver.shape,
        solver.pitch_um,
        lambda: (live.dropped, live.problem),
        live.close,
    )


def _height_frame(solved: SolvedFrame, live: LiveHeights, pitch_um: float) -> HeightFrame:
    problem = solved.reason
    if solved.statistics is not None and solved.statistics.is_relative:
        problem = NO_ZERO
    return HeightFrame(
        solved.number, solved.name, live.time_s(solved), solved.height_um, solved.sigma_um, pitch_um, problem
    )
