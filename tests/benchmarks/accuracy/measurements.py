"""Measures every figure that a mark needs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

import numpy as np

from tests.benchmarks.accuracy import real_sets
from tests.benchmarks.accuracy.marks import BANDS_DEG, SKINS
from tests.benchmarks.accuracy.resolution import mosaic_resolution, three_channel_resolution
from tests.benchmarks.accuracy.sigma_coverage import NOTHING
from tests.benchmarks.accuracy.twin_instrument import TwinInstrument, reference_profile
from tests.benchmarks.accuracy.twin_verdict import OBJECTS, PLACES, judge_instrument

Figure = tuple[str, float]

UNTOUCHED_FRAMES: Final = 4
"""Of nothing, on each skin of the twin."""


def real_figures(folder: Path, report_progress: Callable[[str], None]) -> Iterator[Figure]:
    """Figures of the available real sets; results stay in the folder."""
    for name in filter(real_sets.available, real_sets.SETS):
        verdict = real_sets.judge_set(name, folder / name, lambda words, name=name: report_progress(f"{name}: {words}"))
        if not verdict["balls"] or verdict["lost"]:
            continue  # figures of the easier balls alone are no figures
        yield f"{name} surface", verdict["surface"]["mean"]
        yield f"{name} surface_smooth2", verdict["surface_smooth2"]["mean"]
        yield f"{name} radius off by", abs(verdict["radius_ratio_median"] - 1.0)
        yield f"{name} masked", verdict["masked"]


def twin_figures(folder: Path, report_progress: Callable[[str], None], *, quick: bool) -> Iterator[Figure]:
    """Figures of new presses on the twin with each skin, and of the mosaic's resolution on the diffuse one."""
    heights, slopes = NOTHING, NOTHING
    for skin in SKINS:
        report_progress(f"twin {skin}: calibration")
        instrument = TwinInstrument(reference_profile(skin), folder / skin)
        places, objects = (PLACES[:2], OBJECTS[:1]) if quick else (PLACES, OBJECTS)
        verdict = judge_instrument(
            instrument,
            lambda words, skin=skin: report_progress(f"twin {skin}: {words}"),
            places=places,
            objects=objects,
        )
        yield f"twin {skin} surface", verdict.surface_deg
        yield f"twin {skin} radius off by", verdict.radius_off_by
        yield f"twin {skin} masked", verdict.masked_share
        yield f"twin {skin} untouched skin, rms", untouched_rms_um(instrument, 2 if quick else UNTOUCHED_FRAMES)
        heights, slopes = heights + verdict.heights, slopes + verdict.slopes
        if skin == SKINS[0]:
            report_progress("twin: resolution through the mosaic")
            resolution = mosaic_resolution(instrument)
            yield "Bayer: ridge of 1 px, width", resolution.widest_px
            yield "Bayer: sinusoid of 8 px keeps", resolution.least_kept(8.0)
    for quantity, coverage in (("slope", slopes), ("height", heights)):
        for (low, high), share in zip(BANDS_DEG, coverage.shares(), strict=True):
            if share is not None:
                yield f"twin {quantity} within sigma, {low}-{high} deg", share


def untouched_rms_um(instrument: TwinInstrument, frames: int) -> float:
    """Root mean square height of frames of nothing, whose long waves of noise are taken out as of any frame, µm."""
    heights = [instrument.reconstruct(instrument.lift_off()).height.z_um for _ in range(frames)]
    return float(np.sqrt(np.nanmean(np.square(heights))))


def resolution_figures(folder: Path, report_progress: Callable[[str], None]) -> Iterator[Figure]:
    """Figures of the resolution off the mosaic."""
    report_progress("twin: resolution without a mosaic")
    resolution = three_channel_resolution(reference_profile(SKINS[0]), folder / "three-channels")
    yield "three channels: ridge of 1 px, width", resolution.widest_px
    yield "three channels: sinusoid of 4 px keeps", resolution.least_kept(4.0)
