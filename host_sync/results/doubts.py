"""Doubts of a result: each reason to distrust its heights, judged once here and carried by every output.

A doubt holds for the whole field, or for the sectors of it that it names.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from functools import lru_cache
from pathlib import Path
from typing import Final, TypeVar

import msgspec
import numpy as np

from device.bundles.check import CHECK_FILE, CheckRecord, doubt_of_checks
from device.bundles.record import Identity
from device.bundles.scan import SCAN_MANIFEST, LightFaultRecord, VerdictRecord
from device.calibration.acceptance import SECTORS, sector_indices
from device.surface import Float64Array
from host_sync.results.record import REPLACED, Doubt, DoubtKind, ResultRecord, SequenceRecord, read_record, refusals

EXTRAPOLATED_FRACTION: Final = 0.005
"""Fraction of the field, or of a measured place, from which extrapolated slopes are a doubt."""

FOREIGN_METHOD: Final = "foreign file"
"""Method in the record of a surface from another instrument's file."""

DRIFT_CHECKS: Final = frozenset({"light levels", "light position", "untouched skin"})
"""Frame checks that a light which drifted, moved or failed does not pass."""

CERTIFICATE_FILE: Final = "certificate.json"
MAX_CERTIFICATE_BYTES: Final = 16_000_000
_NO_ZERO: Final = "no zero"
StructT = TypeVar("StructT", bound=msgspec.Struct)

_BUNDLE: Final = r"[a-z0-9][a-z0-9-]*"


def result_doubts(folder: Path, record: ResultRecord) -> tuple[Doubt, ...]:
    """Return the doubts of a result in its folder, with those that a certificate of its calibration raises."""
    certified = _check_standards(folder, record.calibration_id, record.calibration_bundle)
    return (*record_doubts(record), *certified, *_said_later(folder, record))


def video_doubts(folder: Path, record: SequenceRecord) -> tuple[Doubt, ...]:
    """Return the doubts of a video's result in its folder."""
    return (*record.doubts, *_check_standards(folder, record.calibration_id, None))


def quick_look_doubts(scan: Path) -> tuple[Doubt, ...]:
    """Return the doubts of the device's own height map in a scan's folder; none where its manifest cannot be read."""
    manifest = _decoded(scan / SCAN_MANIFEST, _ScanManifest)
    if manifest is None:
        return ()
    found = [*_check_standards(scan / "results" / "quick look", None, manifest.calibration_id)]
    found += _failed_checks(scan, manifest)
    found += _replacement(scan)
    if manifest.light_faults:
        faults = ", ".join(f"{fault.light} is {fault.kind}" for fault in manifest.light_faults)
        found.append(Doubt("drifted light", f"the light driver reported that {faults}"))
    if manifest.verdict is not None and manifest.verdict.level != "good":
        found.append(
            Doubt("reconstruction", f"the handheld's verdict is {manifest.verdict.level}: {manifest.verdict.reason}")
        )
    return tuple(found)


def stated_doubts(folder: Path) -> tuple[str, ...]:
    """Return the doubts of the result in a folder, a sentence each; errors as for `read_record`."""
    return tuple(doubt.sentence for doubt in result_doubts(folder, read_record(folder)))


def record_doubts(record: ResultRecord) -> tuple[Doubt, ...]:
    """Return the doubts that a result's own record states; none is stated twice."""
    return tuple(_of_record(record))


def doubts_at(
    doubts: Iterable[Doubt], places: Float64Array, shape: tuple[int, int], extrapolated_share: float | None
) -> tuple[Doubt, ...]:
    """Return the doubts that concern a measured place.

    places : float64 array of shape (N, 2), row and column of points that lie all over it, px
    shape : (H, W) of the field
    extrapolated_share : fraction of the place with extrapolated slopes; None is unknown, and the field's doubt stays
    """
    inside = {SECTORS[number] for number in np.unique(sector_indices(places[:, 0], places[:, 1], shape))}
    found = []
    for doubt in doubts:
        if doubt.kind == "extrapolated slopes" and extrapolated_share is not None:
            continue
        if not doubt.sectors:
            found.append(doubt)
        elif here := tuple(name for name in doubt.sectors if name in inside):
            found.append(_uncovered(here))
    if extrapolated_share is not None and extrapolated_share > EXTRAPOLATED_FRACTION:
        found.append(_extrapolated(extrapolated_share, "the measured place"))
    return tuple(found)


def _of_record(record: ResultRecord) -> Iterator[Doubt]:
    if record.calibration_passed is False:
        why = "; ".join(record.calibration_failed_checks or record.calibration_notes)
        yield Doubt("failed calibration", f"the calibration did not pass its checks{f': {why}' if why else ''}")
    if record.uncovered_sectors:
        yield _uncovered(record.uncovered_sectors)
    if (record.extrapolated_share or 0.0) > EXTRAPOLATED_FRACTION:
        yield _extrapolated(record.extrapolated_share or 0.0, "the field")
    drifted = set(refusals(check for check in record.frame_checks if check.name in DRIFT_CHECKS))
    unlike = set(refusals(record.frame_checks)) - drifted
    for words in record.warnings:
        if words.startswith(_NO_ZERO):
            continue
        kind: DoubtKind = "foreign file" if record.method == FOREIGN_METHOD else "reconstruction"
        if words in drifted or words in unlike:
            kind = "drifted light" if words in drifted else "frame unlike calibration"
        yield Doubt(kind, words)
    for words in refusals(record.frame_checks):
        if words not in record.warnings:
            yield Doubt("drifted light" if words in drifted else "frame unlike calibration", words)
    relative = next((words for words in record.warnings if words.startswith(_NO_ZERO)), "")
    if relative or record.height_zero.startswith("none"):
        yield Doubt("no zero", relative.removeprefix(f"{_NO_ZERO}: ") or "heights are relative")
    if record.integration is not None and not record.integration.converged:
        yield Doubt("not converged", "the integration did not reach its limit")


def _uncovered(sectors: tuple[str, ...]) -> Doubt:
    return Doubt("uncovered sector", f"balls of the calibration do not cover {', '.join(sectors)}", sectors)


def _extrapolated(share: float, where: str) -> Doubt:
    words = f"{share:.1%} of {where} has slopes beyond those of the calibration balls"
    return Doubt("extrapolated slopes", words)


class _Specimen(msgspec.Struct, frozen=True):
    """Fields of a specimen that are read from a certificate."""

    name: str = ""
    agrees: bool | None = None


class _Certificate(msgspec.Struct, frozen=True):
    """Fields that are read from a certificate."""

    calibration_id: str
    verdict: str
    specimens: tuple[_Specimen, ...] = ()


def _check_standards(folder: Path, calibration_id: str | None, bundle: str | None) -> Iterator[Doubt]:
    """Yield the doubt that a certificate next to the result or its calibration states of the calibration.

    calibration_id : None takes every certificate
    """
    for place in _certificate_places(folder, bundle):
        found = _decoded(place, _Certificate)
        if found is None or found.verdict != "does not agree" or calibration_id not in (None, found.calibration_id):
            continue
        names = ", ".join(one.name for one in found.specimens if one.agrees is False) or "a check standard"
        yield Doubt("failed check standard", f"the instrument does not agree with {names}")
        return


def check_standard(folder: Path, record: ResultRecord) -> str:
    """Return the verdict of certificates on the calibration: "agrees: step 100, ball"; empty without one."""
    for place in _certificate_places(folder, record.calibration_bundle):
        found = _decoded(place, _Certificate)
        if found is not None and found.calibration_id == record.calibration_id:
            return f"{found.verdict}: {', '.join(one.name for one in found.specimens) or 'no specimen'}"
    return ""


class _ScanManifest(msgspec.Struct, frozen=True):
    """Fields that are read from a scan's manifest."""

    identity: Identity
    calibration_id: str | None = None
    check: CheckRecord | None = None
    light_faults: tuple[LightFaultRecord, ...] | None = None
    verdict: VerdictRecord | None = None


def _said_later(folder: Path, record: ResultRecord) -> Iterator[Doubt]:
    """Yield the doubts that the handheld recorded about a library's scan afterwards.

    They are failed checks, and that the scan was taken again.
    """
    scan = folder.absolute().parent.parent
    if record.scan_id is None or scan.name != record.scan_id:
        return
    manifest = _decoded(scan / SCAN_MANIFEST, _ScanManifest)
    if manifest is not None:
        yield from _failed_checks(scan, manifest)
    yield from _replacement(scan)


def _replacement(scan: Path) -> Iterator[Doubt]:
    if newer := replacing(scan):
        yield Doubt(REPLACED, f"it was taken again as {newer}")


def _failed_checks(scan: Path, manifest: _ScanManifest) -> Iterator[Doubt]:
    try:
        known = _checks_in(scan.parent, scan.parent.stat().st_mtime_ns)
    except OSError:
        return
    checks = {check.scan_id: check for check in (*known, *((manifest.check,) if manifest.check else ()))}
    mine = (check for check in checks.values() if check.calibration_id == manifest.calibration_id)
    if failed := doubt_of_checks(manifest.identity.counter, mine):
        yield Doubt("failed check standard", failed.sentence)


@lru_cache(maxsize=4)
def _checks_in(scans: Path, _changed_ns: int) -> tuple[CheckRecord, ...]:
    """Return every check among the scans of a library; read again once a scan comes or goes."""
    found = (_decoded(path, CheckRecord) for path in scans.glob(f"*/{CHECK_FILE}"))
    return tuple(check for check in found if check is not None)


def _decoded(path: Path, kind: type[StructT]) -> StructT | None:
    try:
        if not path.is_file() or path.stat().st_size > MAX_CERTIFICATE_BYTES:
            return None
        return msgspec.json.decode(path.read_bytes(), type=kind)
    except (OSError, ValueError):
        return None


def _certificate_places(folder: Path, calibration_bundle: str | None) -> Iterator[Path]:
    beside = folder.absolute().parent
    yield beside / CERTIFICATE_FILE
    yield beside / "calibration" / CERTIFICATE_FILE
    if calibration_bundle and re.fullmatch(_BUNDLE, calibration_bundle):
        bundle = beside.parent.parent.parent / "calibrations" / calibration_bundle / "results"
        yield from sorted(bundle.glob(f"*/{CERTIFICATE_FILE}"))


# Scans of a library that were taken again: the handheld's record of the later scan names the one it replaces.


class _Manifest(msgspec.Struct, frozen=True):
    """Fields that are read from a scan's manifest."""

    replaces: str | None = None


def replacing(scan: Path) -> str | None:
    """Return the id of the scan that replaces the one in a folder of a library; None without one.

    A replacement that the library does not hold replaces nothing there.
    """
    try:
        return _replaced_in(scan.parent, scan.parent.stat().st_mtime_ns).get(scan.name)
    except OSError:
        return None


@lru_cache(maxsize=4)
def _replaced_in(scans: Path, _changed_ns: int) -> dict[str, str]:
    """Return the id of the replacing scan by that of the replaced one; read again once a scan comes or goes."""
    found = {}
    for manifest in sorted(scans.glob(f"*/{SCAN_MANIFEST}")):
        try:
            content = manifest.read_bytes()
            # Most scans replace none: not decoding those saves nearly all of the time.
            old = msgspec.json.decode(content, type=_Manifest).replaces if b'"replaces": "' in content else None
        except (OSError, ValueError):
            continue
        if old is not None:
            found[old] = manifest.parent.name
    return found
