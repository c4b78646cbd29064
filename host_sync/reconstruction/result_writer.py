"""The result files of one reconstruction, written whole or not at all."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import version
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import tifffile

from device.io.atomic import atomic_directory
from device.surface import Float32Array, HeightMap
from host_sync.calibration.calibrate import Calibration
from host_sync.filters.form import DetailBand, detail
from host_sync.reconstruction.pipeline import Reconstruction
from host_sync.render.relief_sheet import write_relief
from host_sync.results.field_file import write_field, write_mask
from host_sync.results.files import (
    DETAIL_FILE,
    DETAIL_PICTURE_FILE,
    EXTRAPOLATED_FILE,
    HEIGHT_FILE,
    HEIGHT_SIGMA_FILE,
    OTHER_HEIGHT_FILES,
    RECORD_FILE,
    RELIEF_FILE,
    SAMPLES_FILE,
    SLOPE_P_FILE,
    SLOPE_Q_FILE,
    SLOPE_SIGMA_FILE,
    UNTOUCHED_FILE,
    other_detail,
)
from host_sync.results.record import DetailRecord, HeightScale, IntegrationRecord, ResultRecord, encode_record

MAX_SAMPLES = 500_000
"""So many pixels give the median of an uncertainty to less than a thousandth of itself."""

HATCHED_FROM = 0.005
"""A smaller extrapolated share is not named."""

WRITERS = 2
"""Files written at a time: the relief takes about as long as the fields together."""


def write_result(
    target: Path,
    reconstruction: Reconstruction,
    calibration: Calibration,
    name: str,
    facts: dict[str, Any] | None = None,
    band: DetailBand | None = None,
) -> None:
    """Write height, slopes, σ, relief and `result.json` to the directory `target`, replacing what stood there.

    facts : more fields of the record
    band : nesting indices of the detail that is written beside the height map, if any

    Raises
    ------
    OutputError
        The place cannot be written; what stood there stands.
    """
    with atomic_directory(target, RECORD_FILE) as folder:
        fields = {
            HEIGHT_FILE: (reconstruction.height.z_um, "height, um"),
            SLOPE_P_FILE: (reconstruction.p, "dz/dcolumn, um/um"),
            SLOPE_Q_FILE: (reconstruction.q, "dz/drow, um/um"),
            HEIGHT_SIGMA_FILE: (reconstruction.sigma_um, "standard uncertainty of height, um"),
            SLOPE_SIGMA_FILE: (reconstruction.slope_sigma, "standard uncertainty of either slope, um/um"),
        }
        if reconstruction.other is not None:
            kind = other_detail(reconstruction.detail)
            fields[OTHER_HEIGHT_FILES[kind]] = (reconstruction.other.z_um, f"height with {kind} detail, um")
        with ThreadPoolExecutor(WRITERS) as writers:
            words, hatched = relief_words(reconstruction), reconstruction.extrapolated
            jobs = [writers.submit(write_relief, folder / RELIEF_FILE, reconstruction.height, name, words, hatched)]
            for file, (values, what) in fields.items():
                jobs.append(writers.submit(write_field, folder / file, values, calibration.pitch_um, what))
            jobs.append(writers.submit(write_mask, folder / EXTRAPOLATED_FILE, reconstruction.extrapolated))
            if not reconstruction.datum.is_relative:
                jobs.append(writers.submit(write_mask, folder / UNTOUCHED_FILE, reconstruction.datum.skin))
            jobs.append(writers.submit(write_samples, folder / SAMPLES_FILE, reconstruction, calibration.pitch_um))
            record = result_record(name, reconstruction, calibration)
            for job in jobs:
                job.result()
        detail_record = None if band is None else _write_detail(folder, reconstruction.height, band, name)
        record = msgspec.structs.replace(record, **(facts or {}), detail=detail_record)
        (folder / RECORD_FILE).write_bytes(encode_record(record))


def relief_words(reconstruction: Reconstruction) -> str:
    """Return what is zero in a relief and how uncertain heights are there, and which pixels are hatched."""
    zero = "no zero: heights are relative"
    if not reconstruction.datum.is_relative:
        sigma_um = _median(np.where(reconstruction.datum.skin, reconstruction.sigma_um, np.float32(np.nan)))
        zero = f"0 is untouched skin{'' if sigma_um is None else f' ± {sigma_um:.2g} µm'}"
    share = float(reconstruction.extrapolated.mean())
    return f"{zero}; hatched: extrapolated ({share:.0%})" if share >= HATCHED_FROM else zero


def _write_detail(folder: Path, height: HeightMap, band: DetailBand, name: str) -> DetailRecord:
    """Write the detail's height map and picture; returns its entry of `result.json`."""
    from host_sync.render.picture_file import write_detail  # matplotlib takes a while to load

    fine = detail(height, band)
    indices = ", ".join(f"{n} {v:g} um" for n, v in (("S", band.s_um), ("L", band.l_um)) if v is not None)
    write_field(folder / DETAIL_FILE, fine.z_um, fine.pitch_um, f"height between Gaussian filters {indices}, um")
    write_detail(folder / DETAIL_PICTURE_FILE, fine, f"{name}: {indices.replace('um', 'µm')}")
    seen = np.isfinite(fine.z_um)
    return DetailRecord(
        filter="areal Gaussian, ISO 16610-61",
        s_nesting_index_um=band.s_um,
        l_nesting_index_um=band.l_um,
        rms_um=float(fine.z_um[seen].std()) if seen.any() else None,
    )


def write_samples(path: Path, reconstruction: Reconstruction, pitch_um: float) -> None:
    """Write the height errors that the data allow, float32 TIFF of one page a draw, µm, over the field reduced."""
    samples_um = reconstruction.samples_um
    reduced_um = pitch_um * reconstruction.p.shape[1] / samples_um.shape[2]
    tifffile.imwrite(
        path,
        samples_um,
        photometric="minisblack",
        description=f"height errors that the data allow, um, one page a draw; pixel pitch {reduced_um:g} um",
        metadata=None,
    )


def result_record(name: str, reconstruction: Reconstruction, calibration: Calibration) -> ResultRecord:
    """Return the record of a result."""
    z_um, datum = reconstruction.height.z_um, reconstruction.datum
    finite = bool(np.isfinite(z_um).any())
    rows, columns = z_um.shape
    return ResultRecord(
        name=name,
        program=f"retrograph {version('retrograph')}",
        written_utc=time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        method=reconstruction.method,
        calibration_id=calibration.calibration_id,
        surface_detail=reconstruction.detail,
        slope_noise=calibration.slope_noise,
        reference="frame of the untouched skin" if calibration.has_reference else "fitted to the frames",
        rows=rows,
        columns=columns,
        pixel_pitch_um=calibration.pitch_um,
        pupil_height_mm=_pupil_height_mm(calibration),
        height_min_um=float(np.nanmin(z_um)) if finite else None,
        height_max_um=float(np.nanmax(z_um)) if finite else None,
        height_sigma_median_um=_median(reconstruction.sigma_um),
        height_zero="none: heights are relative" if datum.is_relative else "median of untouched skin",
        height_zero_spread_um=datum.spread_um,
        height_zero_sigma_um=datum.zero_sigma_um,
        height_zero_skin_share=datum.share,
        masked_share=reconstruction.masked_share,
        clipped_share=reconstruction.clipped_share,
        extrapolated_share=float(np.count_nonzero(reconstruction.extrapolated)) / reconstruction.extrapolated.size,
        warnings=tuple(reconstruction.warnings),
        frame_checks=tuple(reconstruction.frame_checks),
        **calibration_facts(calibration),
        height_scale=HeightScale(**msgspec.structs.asdict(calibration.assessment.scale)),
        slope_sigma_median=_median(reconstruction.slope_sigma),
        held_out_error_deg=_number(calibration.held_out_deg[reconstruction.method]),
        integration=IntegrationRecord(
            cycles=reconstruction.integration.cycles,
            residuals=tuple(float(value) for value in reconstruction.integration.residuals),
            islands=reconstruction.integration.components,
            converged=reconstruction.integration.converged,
        ),
    )


def _pupil_height_mm(calibration: Calibration) -> float | None:
    viewpoint = calibration.viewpoint
    return None if viewpoint is None else 1e-3 * viewpoint.height_px * calibration.pitch_um


def calibration_facts(calibration: Calibration) -> dict[str, Any]:
    """Return what a record states of its calibration's checks and coverage."""
    assessment = calibration.assessment
    failed = [check for check in assessment.checks if not check.passed]
    return {
        "calibration_passed": assessment.passed,
        "calibration_notes": tuple(assessment.notes),
        "calibration_failed_checks": tuple(f"{one.name} {one.words}" for one in failed),
        "uncovered_sectors": assessment.coverage.uncovered,
    }


def _median(values: Float32Array) -> float | None:
    """Return the median of the known values, of every few pixels where there are many; None where there are none."""
    step = max(1, int(np.sqrt(values.size / MAX_SAMPLES)))
    sample = values[::step, ::step]
    known = sample[np.isfinite(sample)]
    return float(np.median(known)) if known.size else None


def _number(value: float) -> float | None:
    return value if np.isfinite(value) else None
