"""Provenance of a result: its scan, its calibration, and the hashes of all files of the report."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import msgspec

from device.bundles.record import describe_file
from device.bundles.scan import SCAN_MANIFEST, ScanBundle, read_scan
from device.errors import DeviceError
from host_sync.errors import MeasurementError
from host_sync.results.files import OVERVIEW_FILE
from host_sync.results.record import ResultRecord

CALIBRATION_REPORT: Final = "report.json"
MAX_BYTES: Final = 64 << 20

_BUNDLE: Final = r"[a-z0-9][a-z0-9-]*"


@dataclass(frozen=True, slots=True)
class Origin:
    """The files around a result.

    scan : scan bundle of a result in a library; or None
    calibration : the calibration's report, if found
    calibration_file : path of the report
    """

    scan: ScanBundle | None
    calibration: dict[str, Any] | None
    calibration_file: Path | None

    @property
    def overview(self) -> Path | None:
        """The overview picture beside the calibration's report, if there is one."""
        place = self.calibration_file.with_name(OVERVIEW_FILE) if self.calibration_file else None
        return place if place is not None and place.is_file() else None


def origin_of(folder: Path, record: ResultRecord) -> Origin:
    """Return the files around a result: the scan bundle above its folder, and its calibration's report."""
    above = folder.absolute().parent.parent
    scan = None
    if (above / SCAN_MANIFEST).is_file():
        try:
            scan = read_scan(above)
        except DeviceError:
            scan = None  # `verify` reports a damaged bundle; here it counts as absent
    places = [folder.absolute().parent / "calibration" / CALIBRATION_REPORT]
    if record.calibration_bundle and re.fullmatch(_BUNDLE, record.calibration_bundle):
        bundle = above.parent.parent / "calibrations" / record.calibration_bundle / "results"
        places += sorted(bundle.glob(f"*/{CALIBRATION_REPORT}"))
    for place in places:
        report = _report(place)
        if report is not None and report.get("calibration_id") == record.calibration_id:
            return Origin(scan, report, place)
    return Origin(scan, None, None)


def hashed_files(folder: Path, origin: Origin) -> tuple[tuple[str, str, str], ...]:
    """Name, bytes and SHA-256 of the result's files, the scan's manifest and frame, the calibration's report.

    Raises
    ------
    MeasurementError
        A file cannot be read.
    """
    held = sorted(folder.iterdir()) if folder.is_dir() else [folder]
    files = [(f"result/{path.name}", path) for path in held if path.is_file()]
    if origin.scan is not None:
        record = origin.scan.record
        files += [(f"scan/{name}", origin.scan.directory / name) for name in (SCAN_MANIFEST, record.raw_file)]
    if origin.calibration_file is not None:
        files.append((f"calibration/{CALIBRATION_REPORT}", origin.calibration_file))
    return tuple(hashed_file(name, path) for name, path in files)


def hashed_file(name: str, path: Path) -> tuple[str, str, str]:
    """Name, bytes and SHA-256 of a file.

    Raises
    ------
    MeasurementError
        It cannot be read.
    """
    try:
        entry = describe_file(path)
    except OSError as error:
        raise MeasurementError(f"{path}: cannot be read ({error.strerror}): fetch or reconstruct it again") from error
    return name, str(entry.size), entry.sha256


def _report(place: Path) -> dict[str, Any] | None:
    try:
        if place.stat().st_size > MAX_BYTES:
            return None
        return msgspec.json.decode(place.read_bytes(), type=dict[str, Any])
    except (OSError, msgspec.DecodeError, UnicodeDecodeError):
        return None
