"""Checking a library against intake record and manifests: distinguishes lost, changed and unrecorded bundles."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from device.bundles.bundle import MANIFESTS, PARTIAL_SUFFIX, DamagedBundle
from device.bundles.record import (
    Record,
    ShortText,
    checksum_name,
    decode_record,
    encode_record,
    read_manifest,
    read_small,
    sha256_bytes,
)
from device.errors import RecordError
from device.io.atomic import RESULTS, replace_file
from host_sync.library.intake import BundleKey, IntakeEntry
from host_sync.library.library import AnyBundle, Library

CURSOR_FILE: Final = "verify-cursor.json"
_MANIFESTS: Final = frozenset({*MANIFESTS.values(), *(checksum_name(name) for name in MANIFESTS.values())})


class VerifyCursor(Record, frozen=True, tag_field="schema", tag="retrograph.verify-cursor/1"):
    """End of the last partial verification: "scans/<id>"."""

    last: ShortText


@dataclass(frozen=True, slots=True)
class Verification:
    """Findings of a verification.

    sound : how many bundles are whole
    lost : bundles of the intake record that the library no longer has, a sentence each
    damaged : bundles that are not as they were taken in, and why
    unrecorded : whole bundles that the intake record does not know
    unlisted_files : files inside bundles that no manifest lists
    unfinished : transfers that can be continued
    record_fault : why the intake record cannot be trusted, or None
    skipped : bundles that a partial verification did not hash
    """

    sound: int
    lost: tuple[DamagedBundle, ...]
    damaged: tuple[DamagedBundle, ...]
    unrecorded: tuple[Path, ...]
    unlisted_files: tuple[Path, ...]
    unfinished: tuple[Path, ...]
    record_fault: str | None
    skipped: int = 0

    @property
    def complete(self) -> bool:
        """True if nothing is lost, damaged or doubtful."""
        return not self.lost and not self.damaged and self.record_fault is None

    @property
    def total(self) -> int:
        """Return how many bundles were looked at, the lost ones included."""
        return self.sound + len(self.damaged) + len(self.lost)


def verify_library(
    library: Library, report_progress: Callable[[str], None] = lambda _: None, *, fraction: float = 1.0
) -> Verification:
    """Compare a library with its intake record, and hash the files of its bundles.

    fraction : share of the bytes to hash, from 0 to 1; the next partial verification continues after this one. Loss
        and unrecorded are looked for in the whole library in any case

    Raises
    ------
    LibraryError
        There is no library, or its folders cannot be read.
    """
    listing = library.bundles()
    bundles, broken = listing.bundles, list(listing.damaged)
    history = library.intake()
    found = {_key(bundle.directory): bundle.directory for bundle in bundles}
    present = found.keys() | {_key(bundle.directory) for bundle in broken}
    lost = [_loss(library, entry) for key, entry in sorted(history.held.items()) if key not in present]
    damaged, unlisted_files, sound = broken, list[Path](), 0
    chosen = bundles if fraction >= 1.0 else _part(library, bundles, fraction)
    for bundle in chosen:
        report_progress(bundle.bundle_id)
        try:
            _check(bundle, history.held.get(_key(bundle.directory)))
            sound += 1
        except RecordError as error:
            damaged.append(DamagedBundle(bundle.directory, str(error)))
        with library.translating("read"):
            unlisted_files += _unlisted(bundle)
    if fraction < 1.0 and chosen:
        _store_cursor(library, chosen[-1])
    unrecorded = [path for key, path in found.items() if key not in history.held] if history.count else []
    with library.translating("read"):
        unfinished = [path for kind in MANIFESTS for path in (library.root / kind).glob(f".*{PARTIAL_SUFFIX}")]
    return Verification(
        sound=sound,
        lost=tuple(lost),
        damaged=tuple(damaged),
        unrecorded=tuple(sorted(unrecorded)),
        unlisted_files=tuple(unlisted_files),
        unfinished=tuple(sorted(unfinished)),
        record_fault=history.fault,
        skipped=len(bundles) - len(chosen),
    )


def adopt(library: Library, verification: Verification) -> int:
    """Record the sound bundles that the intake record does not know, such as an older release's; returns how many.

    A record that cannot be trusted is set aside, and a new one is started.
    """
    broken = {bundle.directory for bundle in verification.damaged}
    adopted = 0
    with library.writing():
        if library.intake().fault is not None:
            library.restart_record()
        held = library.intake().held
        for bundle in library.bundles().bundles:
            kind, bundle_id = _key(bundle.directory)
            if (kind, bundle_id) not in held and bundle.directory not in broken:
                manifest = read_manifest(bundle.directory, MANIFESTS[kind])
                library.record("adopted", kind, bundle_id, manifest, str(library.root))
                adopted += 1
    return adopted


def _check(bundle: AnyBundle, entry: IntakeEntry | None) -> None:
    if entry is not None:
        manifest = read_small(bundle.directory / MANIFESTS[entry.kind])
        if sha256_bytes(manifest) != entry.manifest_sha256:
            raise RecordError(f"{bundle.directory}: its manifest is not the one that was taken in: repair it")
    bundle.verify()


def _loss(library: Library, entry: IntakeEntry) -> DamagedBundle:
    directory = library.root / entry.kind / entry.bundle_id
    came = f"taken in from {entry.source} on {entry.time:%Y-%m-%d}"
    return DamagedBundle(directory, f"{directory}: is lost ({came}): repair it from there or a mirror")


def _part(library: Library, bundles: Sequence[AnyBundle], fraction: float) -> list[AnyBundle]:
    """Return the bundles after the cursor, and from the beginning again, until their bytes make up that fraction."""
    try:
        path = library.root / CURSOR_FILE
        last = decode_record(read_small(path), VerifyCursor, path).last
    except RecordError:
        last = ""
    names = ["/".join(_key(bundle.directory)) for bundle in bundles]
    first = sum(name <= last for name in names)
    sizes = {bundle.directory: sum(file.size for file in bundle.record.files.values()) for bundle in bundles}
    wanted, chosen, done = fraction * sum(sizes.values()), list[AnyBundle](), 0
    for bundle in (*bundles[first:], *bundles[:first]):
        if chosen and done >= wanted:
            break
        chosen.append(bundle)
        done += sizes[bundle.directory]
    return chosen


def _store_cursor(library: Library, bundle: AnyBundle) -> None:
    with library.translating("written"):
        data = encode_record(VerifyCursor(last="/".join(_key(bundle.directory))))
        replace_file(library.root / CURSOR_FILE, data)


def _key(directory: Path) -> BundleKey:
    return ("scans" if directory.parent.name == "scans" else "calibrations"), directory.name


def _unlisted(bundle: AnyBundle) -> list[Path]:
    expected = {RESULTS, *_MANIFESTS, *bundle.record.files}
    return sorted(path for path in bundle.directory.iterdir() if path.name not in expected)
