"""The result files of one reconstruction, written whole or not at all."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import version
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np
import tifffile
from numpy.typing import NDArray

from device.surface import Float32Array, HeightMap
from host_sync.calibration.full_calibration import Calibration
from host_sync.detail_band import DetailBand
from host_sync.reconstruction.detail_filter import detail
from host_sync.reconstruction.pipeline import Reconstruction
from host_sync.reconstruction.whole_directory import whole_directory
from host_sync.render.detail_picture import write_detail
from host_sync.render.relief_sheet import write_relief

SCHEMA = "retrograph.result/1"
RECORD_FILE = "result.json"
DRAWS_FILE = "height_draws_um.tif"
EXTRAPOLATED_FILE = "extrapolated.png"
"""White where a slope lies beyond what the calibration taught."""

MOST_SAMPLES = 500_000
"""So many pixels give the median of an uncertainty to less than a thousandth of itself."""

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

    facts : more entries for `result.json`
    band : nesting indices of the detail that is written beside the height map, if any

    Raises
    ------
    ResultError
        The place cannot be written; what stood there stands.
    """
    with whole_directory(target, RECORD_FILE) as folder:
        fields = {
            "height_um.tif": (reconstruction.height.z_um, "height, um"),
            "slope_p.tif": (reconstruction.p, "dz/dcolumn, um/um"),
            "slope_q.tif": (reconstruction.q, "dz/drow, um/um"),
            "height_sigma_um.tif": (reconstruction.sigma_um, "standard uncertainty of height, um"),
            "slope_sigma.tif": (reconstruction.slope_sigma, "standard uncertainty of either slope, um/um"),
        }
        with ThreadPoolExecutor(WRITERS) as writers:
            jobs = [writers.submit(write_relief, folder / "relief.png", reconstruction.height, name)]
            for file, (values, what) in fields.items():
                jobs.append(writers.submit(write_field, folder / file, values, calibration.pitch_um, what))
            mask = np.where(reconstruction.extrapolated, np.uint8(255), np.uint8(0))
            jobs.append(writers.submit(_write_mask, folder / EXTRAPOLATED_FILE, mask))
            jobs.append(writers.submit(write_draws, folder / DRAWS_FILE, reconstruction, calibration.pitch_um))
            for job in jobs:
                job.result()
        record = result_record(name, reconstruction, calibration) | (facts or {})
        if band is not None:
            record |= {"detail": _write_detail(folder, reconstruction.height, band, name)}
        (folder / RECORD_FILE).write_bytes(msgspec.json.format(msgspec.json.encode(record), indent=2))


def _write_detail(folder: Path, height: HeightMap, band: DetailBand, name: str) -> dict[str, Any]:
    """Write the detail's height map and picture; returns its entry of `result.json`."""
    fine = detail(height, band)
    indices = ", ".join(f"{n} {v:g} um" for n, v in (("S", band.s_um), ("L", band.l_um)) if v is not None)
    write_field(folder / "detail_um.tif", fine.z_um, fine.pitch_um, f"height between Gaussian filters {indices}, um")
    write_detail(folder / "detail.png", fine, f"{name}: {indices.replace('um', 'µm')}")
    seen = np.isfinite(fine.z_um)
    return {
        "filter": "areal Gaussian, ISO 16610-61",
        "s_nesting_index_um": band.s_um,
        "l_nesting_index_um": band.l_um,
        "rms_um": float(fine.z_um[seen].std()) if seen.any() else None,
    }


def write_field(path: Path, values: Float32Array, pitch_um: float, description: str) -> None:
    """Write a float32 TIFF, tiled, not compressed (every reader opens it), NaN where invalid, with its resolution."""
    per_cm = 1e4 / pitch_um
    tifffile.imwrite(
        path,
        np.ascontiguousarray(values, np.float32),
        tile=(256, 256),
        resolution=(per_cm, per_cm),
        resolutionunit="CENTIMETER",
        description=f"{description}; pixel pitch {pitch_um:g} um; NaN is invalid",
        metadata=None,
    )


def _write_mask(path: Path, mask: NDArray[np.uint8]) -> None:
    """Write a mask of shape (H, W) as a PNG of one channel."""
    done, encoded = cv2.imencode(".png", mask)
    assert done  # noqa: S101 - memory is all it needs
    path.write_bytes(encoded.tobytes())


def write_draws(path: Path, reconstruction: Reconstruction, pitch_um: float) -> None:
    """Write the height errors that the data allow, float32 TIFF of one page a draw, µm, over the field reduced."""
    draws_um = reconstruction.draws_um
    reduced_um = pitch_um * reconstruction.p.shape[1] / draws_um.shape[2]
    tifffile.imwrite(
        path,
        draws_um,
        photometric="minisblack",
        compression="zlib",
        predictor=True,
        description=f"height errors that the data allow, um, one page a draw; pixel pitch {reduced_um:g} um",
        metadata=None,
    )


def result_record(name: str, reconstruction: Reconstruction, calibration: Calibration) -> dict[str, Any]:
    """What `result.json` says: units are in the names, missing readings are null."""
    z_um = reconstruction.height.z_um
    finite = bool(np.isfinite(z_um).any())
    rows, columns = z_um.shape
    return {
        "schema": SCHEMA,
        "name": name,
        "program": f"retrograph {version('retrograph')}",
        "written_utc": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        "method": reconstruction.method,
        "calibration_id": calibration.calibration_id,
        "reference": "frame of the skin at rest" if calibration.has_reference else "fitted to the frames",
        "rows": rows,
        "columns": columns,
        "pixel_pitch_um": calibration.pitch_um,
        "height_min_um": float(np.nanmin(z_um)) if finite else None,
        "height_max_um": float(np.nanmax(z_um)) if finite else None,
        "height_sigma_median_um": _median(reconstruction.sigma_um),
        "height_zero": "median of untouched skin",
        "masked_share": reconstruction.masked_share,
        "clipped_share": reconstruction.clipped_share,
        "extrapolated_share": float(reconstruction.extrapolated.mean()),
        "warnings": list(reconstruction.warnings),
        "calibration_passed": calibration.assessment.passed,
        "calibration_notes": list(calibration.assessment.notes),
        "height_scale": calibration.assessment.scale,
        "slope_sigma_median": _median(reconstruction.slope_sigma),
        "held_out_error_deg": _number(calibration.held_out_deg[reconstruction.method]),
        "integration": {
            "cycles": reconstruction.integration.cycles,
            "residuals": [float(value) for value in reconstruction.integration.residuals],
            "islands": reconstruction.integration.islands,
            "converged": reconstruction.integration.converged,
        },
    }


def _median(values: Float32Array) -> float | None:
    """Median of the known values, of every few pixels where there are many; None where there are none."""
    step = max(1, int(np.sqrt(values.size / MOST_SAMPLES)))
    sample = values[::step, ::step]
    known = sample[np.isfinite(sample)]
    return float(np.median(known)) if known.size else None


def _number(value: float) -> float | None:
    return value if np.isfinite(value) else None
