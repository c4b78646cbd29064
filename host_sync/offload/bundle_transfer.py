"""One bundle from a source into a directory of its own, hashed on the way and once more as it was stored.

A transfer that was cut leaves `<file>.part`; the next one hashes what is there and asks for the rest.
"""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Protocol

from device.bundle_layout import MANIFESTS, BundleKind
from device.calibration_bundle import decode_calibration
from device.errors import RecordError
from device.records import (
    CHUNK_BYTES,
    MOST_MANIFEST_BYTES,
    FileEntry,
    check_seal,
    describe_file,
    seal_name,
    seal_of,
    verify_files,
)
from device.scan_bundle import decode_scan
from host_sync.offload.source import Source

PART: Final = ".part"
WRITE_BACK_BYTES: Final = 4 << 20
"""The disk is given work while a file still comes, so that it has little left to do at its end."""


class Advance(Protocol):
    """Is told bytes as they are there: fetched from the source, or found in what an earlier transfer had left."""

    def __call__(self, size_bytes: int, *, fetched: bool) -> None:
        """Take note of so many bytes more, or fewer when they had to be dropped."""
        ...


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

    def place(self, name: str) -> str:
        """Where the source has one of the bundle's files."""
        return f"{self.kind}/{self.bundle_id}/{name}"


def read_offer(source: Source, kind: BundleKind, bundle_id: str) -> Offer:
    """The manifest of a bundle, checked.

    Raises
    ------
    SourceError
        It cannot be read.
    RecordError
        It is damaged, of an unknown version, or another bundle's.
    """
    place = f"{kind}/{bundle_id}/{MANIFESTS[kind]}"
    where = f"{source.name}/{place}"
    data = _read_small(source, place)
    check_seal(data, _read_small(source, seal_name(place)), where)
    if kind == "scans":
        scan = decode_scan(data, where)
        found, files, calibration_id = scan.identity, scan.files, scan.calibration_id
    else:
        calibration = decode_calibration(data, where)
        found, files, calibration_id = calibration.identity, calibration.files, None
    if found.id != bundle_id:
        raise RecordError(f"{where}: is the manifest of {found.id}: rename its folder to that")
    return Offer(kind, bundle_id, data, files, calibration_id)


def fetch(source: Source, offer: Offer, into: Path, advance: Advance, known: Mapping[str, Path]) -> None:
    """Complete an offered bundle in a directory that may hold a part of it.

    known : files of this machine by their SHA-256; what is among them is copied (never linked: rot must not spread)

    Raises
    ------
    SourceError
        The source cannot be read; what came is kept.
    RecordError
        What came is not what the manifest promises; names the file.
    OSError
        The directory cannot be written.
    """
    _prepare(offer, into)
    for name, entry in offer.files.items():
        if (into / name).exists() or _copy_known(known.get(entry.sha256), entry, into / name):
            advance(entry.size, fetched=False)
        else:
            _fetch_file(source, offer, name, entry, into / name, advance)


def prove(offer: Offer, into: Path) -> None:
    """Return when a fetched bundle is on the disk, was read back from there, and is what its manifest promises.

    Raises
    ------
    RecordError
        What was stored is not what came; names the file.
    OSError
        The directory cannot be written.
    """
    for name in offer.files:
        _settle(into / name)
    verify_files(into, offer.files)


def _prepare(offer: Offer, into: Path) -> None:
    """Make the directory hold the offer's manifest, and of anything older only what belongs to it."""
    manifest = MANIFESTS[offer.kind]
    seal = seal_of(manifest, offer.manifest)
    same = (into / manifest).is_file() and (into / manifest).read_bytes() == offer.manifest
    parts = {name + PART for name in offer.files}
    for path in into.iterdir():
        if not same or path.name not in {manifest, *offer.files, *parts}:
            path.unlink()
    (into / manifest).write_bytes(offer.manifest)
    (into / seal_name(manifest)).write_bytes(seal)


def _copy_known(path: Path | None, entry: FileEntry, target: Path) -> bool:
    """Whether a file that this machine has was copied, and its copy is what the manifest promises."""
    part = target.with_name(target.name + PART)
    if path is None or part.exists() or path.is_symlink() or not path.is_file():
        return False
    shutil.copyfile(path, part)
    if describe_file(part) != entry:
        part.unlink()
        return False
    part.rename(target)
    return True


def _fetch_file(source: Source, offer: Offer, name: str, entry: FileEntry, path: Path, advance: Advance) -> None:
    where = f"{source.name}/{offer.place(name)}"
    part = path.with_name(name + PART)
    resumed = part.exists()
    size, digest = _fetch_rest(source, offer.place(name), entry, part, advance)
    if resumed and (size, digest) != (entry.size, entry.sha256):
        advance(-size, fetched=False)
        part.unlink()
        size, digest = _fetch_rest(source, offer.place(name), entry, part, advance)
    if size > entry.size:
        raise RecordError(f"{where}: has more than the {entry.size} bytes that its manifest states")
    if size < entry.size:
        raise RecordError(f"{where}: is truncated, {size} of {entry.size} bytes")
    if digest != entry.sha256:
        raise RecordError(f"{where}: is damaged (its SHA-256 differs from its manifest)")
    part.rename(path)


def _fetch_rest(source: Source, place: str, entry: FileEntry, part: Path, advance: Advance) -> tuple[int, str]:
    """Size and SHA-256 of a file that was completed in `part`; it stops as soon as more comes than is promised."""
    digest, size, pending = hashlib.sha256(), 0, 0
    with part.open("a+b") as stored:
        stored.seek(0)
        while block := stored.read(CHUNK_BYTES):
            digest.update(block)
            size += len(block)
        advance(size, fetched=False)
        if size < entry.size:
            with closing(source.blocks(place, size)) as blocks:
                for block in blocks:
                    stored.write(block)
                    digest.update(block)
                    size += len(block)
                    pending += len(block)
                    if pending >= WRITE_BACK_BYTES:
                        stored.flush()
                        _let_go(stored.fileno())
                        pending = 0
                    advance(len(block), fetched=True)
                    if size > entry.size:
                        break
    return size, digest.hexdigest()


def _read_small(source: Source, place: str) -> bytes:
    data = b""
    with closing(source.blocks(place)) as blocks:
        for block in blocks:
            data += block
            if len(data) > MOST_MANIFEST_BYTES:
                raise RecordError(f"{source.name}/{place}: is larger than any manifest")
    return data


def _settle(path: Path) -> None:
    """Have a file's bytes on the disk, and out of memory, so that it is the disk that is read back."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
        _let_go(descriptor)
    finally:
        os.close(descriptor)


def _let_go(descriptor: int) -> None:
    """Begin to write what memory holds of a file, and forget what is written already."""
    if hasattr(os, "posix_fadvise"):
        os.posix_fadvise(descriptor, 0, 0, os.POSIX_FADV_DONTNEED)
