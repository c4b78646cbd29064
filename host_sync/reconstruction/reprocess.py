"""Repeats a reconstruction: the same version must give identical bits; across versions, differences are listed."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final, cast, get_args

import msgspec
import numpy as np
import tifffile

from device.bundles.scan import ScanBundle
from device.io.tiff import TIFF_READ_ERRORS, quiet_tiff_log
from device.surface import Float32Array
from host_sync.calibration.calibrate import Method
from host_sync.errors import ResultError
from host_sync.library.library import Library
from host_sync.reconstruction.scans import LibraryReconstructor
from host_sync.results.files import RECORD_FILE

_PROVENANCE_KEYS: Final = frozenset({"written_utc", "program"})


@dataclass(frozen=True, slots=True)
class Comparison:
    """Stored results compared with the same work done now.

    same_version : whether this version wrote them; only then must they be identical
    differences : one sentence each; empty when every bit agrees
    """

    results: Path
    same_version: bool
    differences: tuple[str, ...]

    @property
    def as_promised(self) -> bool:
        """Identical, or written by another version."""
        return not (self.same_version and self.differences)


def reprocess(library: Library, job: LibraryReconstructor, scan: ScanBundle) -> list[Comparison]:
    """Return one comparison for each result folder of a scan.

    Results of this version are not changed; results of other versions get this version's beside them.

    Raises
    ------
    ResultError
        Stored results cannot be read.
    RecordError, MissingCalibration, CalibrationMismatch
        As in reconstruction.
    """
    comparisons = []
    for stored in library.results(scan):
        record = _read_record(stored)
        same_version = record.get("program") == f"retrograph {version('retrograph')}"
        method = record.get("method")
        chosen = cast("Method", method) if method in get_args(Method) else None
        if same_version:
            with tempfile.TemporaryDirectory(prefix=".again-", dir=stored.parent) as folder:
                _, fresh = job.run(scan, chosen, Path(folder) / stored.name)
                differences = compare(stored, fresh)
        else:
            _, fresh = job.run(scan, chosen)
            differences = compare(stored, fresh)
        comparisons.append(Comparison(stored, same_version, tuple(differences)))
    return comparisons


def compare(stored: Path, fresh: Path) -> list[str]:
    """Return differences between two result folders, one sentence each.

    Raises
    ------
    ResultError
        A folder cannot be read.
    """
    differences = []
    for name in sorted({path.name for folder in (stored, fresh) for path in folder.glob("*.tif")}):
        if not ((stored / name).is_file() and (fresh / name).is_file()):
            differences.append(f"{name} is missing in the {'stored' if (fresh / name).is_file() else 'new'} results")
        elif (stored / name).read_bytes() != (fresh / name).read_bytes():
            differences.append(_describe(name, _read_field(stored / name), _read_field(fresh / name)))
    before, after = _read_record(stored), _read_record(fresh)
    keys = sorted((before.keys() | after.keys()) - _PROVENANCE_KEYS)
    differences += [
        f"{key}: {before.get(key)} before, {after.get(key)} now" for key in keys if before.get(key) != after.get(key)
    ]
    return differences


def _describe(name: str, before: Float32Array, after: Float32Array) -> str:
    if before.shape != after.shape:
        return f"{name}: shape was {before.shape}, is now {after.shape}"
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
