"""One bundle from a source into a temporary directory, hashed on the way and once more as it was stored."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from device.bundle_layout import MANIFESTS, BundleKind
from device.calibration_bundle import decode_calibration
from device.errors import RecordError
from device.records import (
    CHUNK_BYTES,
    MOST_MANIFEST_BYTES,
    FileEntry,
    check_seal,
    seal_name,
    seal_of,
    verify_files,
)
from device.scan_bundle import decode_scan
from host_sync.errors import SourceError
from host_sync.offload.source import Source


@dataclass(frozen=True, slots=True)
class Offer:
    """A bundle that a source offers: its manifest as sent, proven by its seal."""

    kind: BundleKind
    bundle_id: str
    manifest: bytes
    files: Mapping[str, FileEntry]
    calibration_id: str | None

    @property
    def size_bytes(self) -> int:
        """Bytes of the files that the manifest lists."""
        return sum(entry.size for entry in self.files.values())


def read_offer(source: Source, kind: BundleKind, bundle_id: str) -> Offer:
    """The manifest of a bundle, checked.

    Raises
    ------
    SourceError
        It cannot be read.
    RecordError
        It is damaged, of an unknown version, or another bundle's.
    """
    name = MANIFESTS[kind]
    where = f"{source.name}/{kind}/{bundle_id}/{name}"
    data = _read_small(source, kind, bundle_id, name)
    check_seal(data, _read_small(source, kind, bundle_id, seal_name(name)), where)
    if kind == "scans":
        scan = decode_scan(data, where)
        found, files, calibration_id = scan.identity, scan.files, scan.calibration_id
    else:
        calibration = decode_calibration(data, where)
        found, files, calibration_id = calibration.identity, calibration.files, None
    if found.id != bundle_id:
        raise RecordError(f"{where}: is the manifest of {found.id}: rename its folder to that")
    return Offer(kind, bundle_id, data, files, calibration_id)


def fetch(source: Source, offer: Offer, into: Path, advance: Callable[[int], None]) -> None:
    """Copy an offered bundle into an empty directory; `advance` is told the bytes of every block.

    Raises
    ------
    SourceError
        The source cannot be read.
    RecordError
        What came, or what was stored, is not what the manifest promises; names the file.
    OSError
        The directory cannot be written.
    """
    for name, entry in offer.files.items():
        _fetch_file(source, offer, name, entry, into / name, advance)
    manifest = MANIFESTS[offer.kind]
    (into / manifest).write_bytes(offer.manifest)
    (into / seal_name(manifest)).write_bytes(seal_of(manifest, offer.manifest))
    verify_files(into, offer.files)


def _fetch_file(
    source: Source, offer: Offer, name: str, entry: FileEntry, path: Path, advance: Callable[[int], None]
) -> None:
    where = f"{source.name}/{offer.kind}/{offer.bundle_id}/{name}"
    digest, size = hashlib.sha256(), 0
    with path.open("xb") as stored:
        for block in _blocks(source, offer.kind, offer.bundle_id, name):
            size += len(block)
            if size > entry.size:
                raise RecordError(f"{where}: has more than the {entry.size} bytes that its manifest states")
            digest.update(block)
            stored.write(block)
            advance(len(block))
        stored.flush()
        os.fsync(stored.fileno())
        _forget_cached(stored.fileno())
    if size < entry.size:
        raise RecordError(f"{where}: is truncated, {size} of {entry.size} bytes")
    if digest.hexdigest() != entry.sha256:
        raise RecordError(f"{where}: is damaged (its SHA-256 differs from its manifest)")


def _blocks(source: Source, kind: BundleKind, bundle_id: str, name: str) -> Iterator[bytes]:
    """A file of the source in blocks; what goes wrong there is a SourceError."""
    with source.open_file(kind, bundle_id, name) as stream:
        while True:
            try:
                block = stream.read(CHUNK_BYTES)
            except OSError as error:
                raise SourceError(
                    f"{source.name}/{kind}/{bundle_id}/{name}: cannot be read ({error.strerror or error}): try again"
                ) from error
            if not block:
                return
            yield block


def _read_small(source: Source, kind: BundleKind, bundle_id: str, name: str) -> bytes:
    data = b""
    for block in _blocks(source, kind, bundle_id, name):
        data += block
        if len(data) > MOST_MANIFEST_BYTES:
            raise RecordError(f"{source.name}/{kind}/{bundle_id}/{name}: is larger than any manifest")
    return data


def _forget_cached(descriptor: int) -> None:
    """Have the stored bytes read from the disk, not from memory, when they are hashed again."""
    if hasattr(os, "posix_fadvise"):
        os.posix_fadvise(descriptor, 0, 0, os.POSIX_FADV_DONTNEED)
