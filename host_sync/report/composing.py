"""Report of a measurement: quantities, uncertainties, calibration and provenance."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import Any, Final

import msgspec

from device.bundles.record import describe_file
from device.bundles.scan import SCAN_MANIFEST, ScanBundle, read_scan
from device.errors import DeviceError
from host_sync.errors import MeasurementError
from host_sync.measurement.measurement import Measurement, operations, shared_warnings
from host_sync.report.pictures import pictures_of
from host_sync.report.writing import VERDICT_HEAD, Picture, Report, Table, Template
from host_sync.results.doubts import check_standard
from host_sync.results.files import OVERVIEW_FILE
from host_sync.results.record import ResultRecord


def compose(measurement: Measurement, template: Template | None = None, logo: Picture | None = None) -> Report:
    """Return the report of a measurement.

    template : whose report it is and which parts it has; all parts by default

    Raises
    ------
    MeasurementError
        A file of the result cannot be read.
    RecordError
        The scan's frame is damaged.
    """
    record = measurement.record
    origin = origin_of(measurement.folder, record)
    notes = list(measurement.notes)
    if origin.scan is None:
        notes.append("frame: not shown, because the result is not in a library with its scan")
    template = template or Template()
    calibration, hashes = _calibration(measurement, origin), _hashes(measurement, origin)
    report = Report(
        title=record.name,
        operations=operations(measurement.recipe),
        facts=tuple((label, value) for label, value in _facts(measurement, origin, template) if value),
        warnings=tuple(_warnings(measurement)),
        pictures=tuple(pictures_of(measurement, origin.scan, origin.overview)) if "pictures" in template.parts else (),
        tables=tuple(_numbers(measurement)),
        notes=tuple(notes) if "notes" in template.parts else (),
        appendix=tuple(
            table for part, table in (("calibration", calibration), ("provenance", hashes)) if part in template.parts
        ),
        head=tuple(line for line in (template.organisation, template.address) if line),
        logo=logo,
        verdict=worst([measurement]),
        footer=template.footer,
    )
    return replace(report, signature=signature(report, hashes))


def worst(measurements: Sequence[Measurement]) -> str:
    """Return the worst verdict over all tolerances, empty without; one that was not measured is undecided."""
    verdicts = {one.limits.verdict for measurement in measurements for one in measurement.quantities if one.limits}
    for measurement in measurements:
        if len(measurement.recipe.tolerance) > sum(one.limits is not None for one in measurement.quantities):
            verdicts.add("undecided")
    return next((one for one in ("fail", "undecided", "pass") if one in verdicts), "")


def signature(report: Report, hashes: Table) -> str:
    """SHA-256 of every word and number that the report prints, and of the files' hashes even where it leaves them out.

    Pictures and the logo are not in it, but for their captions: pictures are drawn from those files.
    """
    stated = (report.title, report.head, report.operations, report.facts, report.warnings, report.verdict)
    tables = [(t.title, t.head, t.rows, t.remarks) for t in (*report.tables, *report.appendix, hashes)]
    captions = [picture.caption for picture in report.pictures]
    beside = (tables, report.notes, captions, report.footer)
    return hashlib.sha256(msgspec.json.encode((stated, beside))).hexdigest()


def place_of(folder: Path, origin: Origin) -> Path:
    """Return the result's path without private parts.

    It is the path within its library, else relative to here, else its last two names.
    """
    if origin.scan is not None:
        return Path(*folder.absolute().parts[-4:])
    if not folder.is_absolute():
        return folder
    return folder.relative_to(Path.cwd()) if folder.is_relative_to(Path.cwd()) else Path(*folder.parts[-2:])


def _facts(measurement: Measurement, origin: Origin, template: Template) -> Iterator[tuple[str, str]]:
    record = measurement.record
    height = measurement.height
    rows, columns = height.z_um.shape
    yield "result", str(place_of(measurement.folder, origin))
    yield "recipe", measurement.recipe.name
    yield "procedure", template.procedure
    yield "instrument", template.instrument
    if origin.scan is not None:
        scan = origin.scan.record
        yield "scan", scan.scan_id
        yield "taken", f"{scan.wall_time:%Y-%m-%d %H:%M} by the device's clock"
        yield "device", f"{scan.identity.device_id}, board {scan.board}"
        notes = scan.annotations
        for label, value in (
            ("job", notes.job),
            ("part", notes.part),
            ("operator", template.operator or notes.operator),
            ("note", notes.note),
        ):
            yield label, value or ""
        yield "last check at the press", scan.check.sentence if scan.check else ""
        yield "verdict at the press", f"{scan.verdict.level}: {scan.verdict.reason}"
    else:
        yield "operator", template.operator
    yield "check standard", check_standard(measurement.folder, record)
    yield "frame set", record.frame_set or ""
    yield "gel", record.gel_id or ""
    yield "reconstructed", f"{record.written_utc} by {record.program}, method {record.method}"
    pitch = height.pitch_um
    yield (
        "field",
        f"{columns} x {rows} pixels of {pitch:g} µm, {columns * pitch / 1e3:.2f} x {rows * pitch / 1e3:.2f} mm",
    )
    if record.masked_share is not None:
        yield "masked", f"{100.0 * record.masked_share:.2g} % of the field"


def _warnings(measurement: Measurement) -> Iterator[str]:
    yield from (doubt.sentence for doubt in measurement.doubts)


def _numbers(measurement: Measurement) -> Iterator[Table]:
    """Yield a table per subject: quantity, value ± uncertainty, warnings."""
    for subject, group in groupby(measurement.quantities, key=lambda one: one.subject):
        quantities = list(group)
        first = quantities[0]
        title = f"{subject}: k = {first.coverage_factor}, {first.coverage}"
        shared = shared_warnings(quantities)
        own = ["; ".join(warning for warning in one.warnings if warning not in shared) for one in quantities]
        remarks = tuple(f"warning: {warning}" for warning in shared)
        if any(one.limits for one in quantities):
            judged = tuple(
                (one.name, one.number, one.limits.words if one.limits else "", words)
                for one, words in zip(quantities, own, strict=True)
            )
            yield Table(title, ("number", "value ± uncertainty", VERDICT_HEAD, "warnings"), judged, remarks)
        else:
            rows = tuple((one.name, one.number, words) for one, words in zip(quantities, own, strict=True))
            yield Table(title, ("number", "value ± uncertainty", "warnings"), rows, remarks)


def _calibration(measurement: Measurement, origin: Origin) -> Table:
    record = measurement.record
    rows = [("calibration", record.calibration_id), ("calibration bundle", record.calibration_bundle or "-")]
    rows.append(("passed", {True: "yes", False: "NO", None: "not known"}[record.calibration_passed]))
    rows.append(("reference", record.reference or "-"))
    if record.held_out_error_deg is not None:
        rows.append(("error of normals on held-out balls", f"{record.held_out_error_deg:.2f}°"))
    steepest_deg = (origin.calibration or {}).get("steepest_slope_deg")
    if isinstance(steepest_deg, float):
        rows.append(("steepest slope of the balls", f"{steepest_deg:.0f}°"))
    scale = record.height_scale
    for label, share in (("pixel pitch", scale.pixel_pitch_share), ("ball radius", scale.ball_radius_share)):
        rows.append((f"± of the {label}", "not measured" if share is None else f"{100.0 * share:.2g} %"))
    rows += [("note", note) for note in record.calibration_notes]
    rows += [(f"check: {name}", text) for name, text in check_lines(origin.calibration or {})]
    return Table("Calibration", ("what", "value"), tuple(rows))


def check_lines(report: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Name and result of each check in a calibration's report."""
    checks = report.get("checks")
    for check in checks if isinstance(checks, list) else []:
        if isinstance(check, dict):
            words = "passed" if check.get("passed") is True else "NOT passed"
            value, limit = _short(check.get("value")), _short(check.get("limit"))
            yield str(check.get("name")), f"{value} ({check.get('kind')} {limit}): {words}"


def _short(value: object) -> str:
    """Return a number with four digits; other values as text."""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _hashes(measurement: Measurement, origin: Origin) -> Table:
    return Table("Provenance", ("file", "bytes", "SHA-256"), hashed_files(measurement.folder, origin))


# Provenance of a result: its scan, its calibration, and the hashes of all files of the report.

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
