"""Doing a reconstruction again: the same version must give the same bits; across versions, what changed is said."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final, cast, get_args

import msgspec
import numpy as np
import tifffile

from device.scan_bundle import ScanBundle
from device.surface import Float32Array
from device.tiff_reading import TIFF_READ_ERRORS, quiet_tiff_log
from host_sync.calibration.full_calibration import Method
from host_sync.errors import ResultError
from host_sync.library import Library
from host_sync.reconstruction.library_job import LibraryJob
from host_sync.reconstruction.results import RECORD_FILE

_WHEN_AND_BY: Final = frozenset({"written_utc", "program"})


@dataclass(frozen=True, slots=True)
class Comparison:
    """Results as they lie there against the same work done now.

    same_version : whether this program wrote them; only then must they be identical
    differences : a sentence each; none when every bit agrees
    """

    results: Path
    same_version: bool
    differences: tuple[str, ...]

    @property
    def as_promised(self) -> bool:
        """Identical, or of another version."""
        return not (self.same_version and self.differences)


def reprocess(library: Library, job: LibraryJob, scan: ScanBundle) -> list[Comparison]:
    """One comparison for each folder of results that a scan has.

    Results of this version are left as they are; beside results of other versions this version's appear.

    Raises
    ------
    ResultError
        Stored results cannot be read.
    RecordError, MissingCalibration, CalibrationMismatch
        As when it was reconstructed.
    """
    comparisons = []
    for stored in library.results(scan):
        record = _read_record(stored)
        same_version = record.get("program") == f"retrograph {version('retrograph')}"
        method = record.get("method")
        chosen = cast("Method", method) if method in get_args(Method) else None
        if same_version:
            with tempfile.TemporaryDirectory(prefix=".again-", dir=stored.parent) as again:
                _, fresh = job.run(scan, chosen, Path(again) / stored.name)
                differences = compare(stored, fresh)
        else:
            _, fresh = job.run(scan, chosen)
            differences = compare(stored, fresh)
        comparisons.append(Comparison(stored, same_version, tuple(differences)))
    return comparisons


def compare(stored: Path, fresh: Path) -> list[str]:
    """What differs between two folders of results, a sentence each.

    Raises
    ------
    ResultError
        One cannot be read.
    """
    differences = []
    for name in sorted({path.name for folder in (stored, fresh) for path in folder.glob("*.tif")}):
        if not ((stored / name).is_file() and (fresh / name).is_file()):
            differences.append(f"{name} is missing {'among the stored' if (fresh / name).is_file() else 'now'}")
        elif (stored / name).read_bytes() != (fresh / name).read_bytes():
            differences.append(_describe(name, _read_field(stored / name), _read_field(fresh / name)))
    before, after = _read_record(stored), _read_record(fresh)
    keys = sorted((before.keys() | after.keys()) - _WHEN_AND_BY)
    differences += [
        f"{key}: {before.get(key)} was, {after.get(key)} is" for key in keys if before.get(key) != after.get(key)
    ]
    return differences


def _describe(name: str, before: Float32Array, after: Float32Array) -> str:
    if before.shape != after.shape:
        return f"{name} was of shape {before.shape} and is of shape {after.shape}"
    valid = np.isfinite(before) & np.isfinite(after)
    validity = int((np.isfinite(before) != np.isfinite(after)).sum())
    step = np.abs(after[valid] - before[valid])
    if not step.size:
        return f"{name}: no pixel is valid in both, {validity} changed validity"
    unit = " um" if "um" in name else ""
    return (
        f"{name}: differs by {np.median(step):.3g}{unit} (median) and {step.max():.3g}{unit} at most; "
        f"{validity} pixels changed validity"
    )


def _read_field(path: Path) -> Float32Array:
    try:
        with quiet_tiff_log():
            return np.asarray(tifffile.imread(path), np.float32)
    except TIFF_READ_ERRORS as error:
        raise ResultError(f"{path}: is damaged: remove its folder and reconstruct again") from error


def _read_record(folder: Path) -> dict[str, Any]:
    path = folder / RECORD_FILE
    try:
        return msgspec.json.decode(path.read_bytes(), type=dict[str, Any])
    except (OSError, msgspec.DecodeError, UnicodeDecodeError) as error:
        raise ResultError(f"{path}: is damaged or missing: remove its folder and reconstruct again") from error
