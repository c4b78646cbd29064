"""One bundle from a source into a directory of its own, hashed on the way and again as it was stored.

An interrupted transfer leaves `<file>.part`; the next one hashes that and requests the rest.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import stat
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Protocol

from device.bundles.bundle import MANIFESTS, BundleKind
from device.bundles.calibration import decode_calibration
from device.bundles.record import (
    CHUNK_BYTES,
    MAX_MANIFEST_BYTES,
    FileEntry,
    check_manifest,
    checksum_name,
    describe_file,
    manifest_checksum,
    read_small,
    verify_files,
)
from device.bundles.scan import decode_scan
from device.errors import RecordError
from device.io.atomic import remove_tree_quietly, sync_file
from device.io.folder import IrregularFile, open_regular
from host_sync.offload.source import Source

PART: Final = ".part"
WRITE_BACK_BYTES: Final = 4 << 20
"""Write-back starts after this much, so that little is left to write at a file's end."""


class Advance(Protocol):
    """Called with bytes as they arrive from the source, or are found in an earlier transfer's part."""

    def __call__(self, size_bytes: int, *, fetched: bool) -> None:
        """Count these bytes; negative when they were dropped."""
        ...


@dataclass(frozen=True, slots=True)
class RemoteBundle:
    """A bundle that a source offers: its manifest as sent, checked by its checksum file."""

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
        """Place of one of the bundle's files in the source."""
        return f"{self.kind}/{self.bundle_id}/{name}"


def read_remote_bundle(source: Source, kind: BundleKind, bundle_id: str) -> RemoteBundle:
    """Return the manifest of a bundle, checked.

    Raises
    ------
    SourceError
        It cannot be read.
    RecordError
        It is damaged, of an unknown version, or belongs to another bundle.
    """
    place = f"{kind}/{bundle_id}/{MANIFESTS[kind]}"
    where = f"{source.name}/{place}"
    data = _read_small(source, place)
    check_manifest(data, _read_small(source, checksum_name(place)), where)
    if kind == "scans":
        scan = decode_scan(data, where)
        found, files, calibration_id = scan.identity, scan.files, scan.calibration_id
    else:
        calibration = decode_calibration(data, where)
        found, files, calibration_id = calibration.identity, calibration.files, None
    if found.id != bundle_id:
        raise RecordError(f"{where}: is the manifest of {found.id}: give its folder that name")
    return RemoteBundle(kind, bundle_id, data, files, calibration_id)


def download(source: Source, offer: RemoteBundle, into: Path, advance: Advance, known: Mapping[str, Path]) -> None:
    """Complete an offered bundle in a directory that may hold a part of it.

    known : files of this machine by their SHA-256; they are copied, never linked, because rot must not spread

    Raises
    ------
    SourceError
        The source cannot be read; what arrived is kept.
    RecordError
        What arrived is not what the manifest states; names the file.
    OSError
        The directory cannot be written.
    """
    _prepare(offer, into)
    for name, entry in offer.files.items():
        if (into / name).exists() or _copy_known(known.get(entry.sha256), entry, into / name):
            advance(entry.size, fetched=False)
        else:
            _download_file(source, offer, name, entry, into / name, advance)


def verify(offer: RemoteBundle, into: Path) -> None:
    """Return when a downloaded bundle is on the disk, was read back from there, and is what its manifest states.

    Raises
    ------
    RecordError
        What was stored is not what arrived; names the file.
    OSError
        The directory cannot be written.
    """
    for name in offer.files:
        _flush(into / name)
    verify_files(into, offer.files)


def _prepare(offer: RemoteBundle, into: Path) -> None:
    """Put the offer's manifest into the directory, and remove everything that does not belong to it."""
    manifest = MANIFESTS[offer.kind]
    parts = {name + PART for name in offer.files}
    same = _has(into / manifest, offer.manifest)
    for path in into.iterdir():
        regular = stat.S_ISREG(path.lstat().st_mode)
        if not same or not regular or path.name not in {manifest, *offer.files, *parts}:
            remove_tree_quietly(path) if path.is_dir() and not path.is_symlink() else path.unlink()
    for name, data in (
        (manifest, offer.manifest),
        (checksum_name(manifest), manifest_checksum(manifest, offer.manifest)),
    ):
        (into / name).unlink(missing_ok=True)
        with (into / name).open("xb") as stream:
            stream.write(data)


def _has(path: Path, data: bytes) -> bool:
    try:
        return read_small(path) == data
    except RecordError:
        return False


def _copy_known(path: Path | None, entry: FileEntry, target: Path) -> bool:
    """Copy a file of this machine; return whether the copy is what the manifest states."""
    part = target.with_name(target.name + PART)
    if path is None or part.exists():
        return False
    try:
        with os.fdopen(open_regular(path), "rb") as stream, part.open("xb") as copy:
            shutil.copyfileobj(stream, copy, CHUNK_BYTES)
    except (FileNotFoundError, IrregularFile):
        return False
    if describe_file(part) != entry:
        part.unlink()
        return False
    part.rename(target)
    return True


def _download_file(
    source: Source, offer: RemoteBundle, name: str, entry: FileEntry, path: Path, advance: Advance
) -> None:
    where = f"{source.name}/{offer.place(name)}"
    part = path.with_name(name + PART)
    resumed = part.exists()
    size, digest = _download_rest(source, offer.place(name), entry, part, advance)
    if resumed and (size, digest) != (entry.size, entry.sha256):
        advance(-size, fetched=False)
        part.unlink()
        size, digest = _download_rest(source, offer.place(name), entry, part, advance)
    if size > entry.size:
        raise RecordError(f"{where}: has more than the {entry.size} bytes that its manifest states")
    if size < entry.size:
        raise RecordError(f"{where}: is truncated, {size} of {entry.size} bytes")
    if digest != entry.sha256:
        raise RecordError(f"{where}: is damaged (its SHA-256 differs from its manifest)")
    part.rename(path)


def _download_rest(source: Source, place: str, entry: FileEntry, part: Path, advance: Advance) -> tuple[int, str]:
    """Complete a file in `part`, and return its size and SHA-256.

    The download stops as soon as more arrives than was stated. An empty file is asked for, too: a source that does not
    have it does not offer this bundle.
    """
    digest, size, pending = hashlib.sha256(), 0, 0
    with part.open("a+b") as stored:
        stored.seek(0)
        while block := stored.read(CHUNK_BYTES):
            digest.update(block)
            size += len(block)
        advance(size, fetched=False)
        if size < entry.size or entry.size == 0:
            with closing(source.blocks(place, size)) as blocks:
                for block in blocks:
                    stored.write(block)
                    digest.update(block)
                    size += len(block)
                    pending += len(block)
                    if pending >= WRITE_BACK_BYTES:
                        stored.flush()
                        _drop_cache(stored.fileno())
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
            if len(data) > MAX_MANIFEST_BYTES:
                raise RecordError(f"{source.name}/{place}: is larger than any manifest")
    return data


def _flush(path: Path) -> None:
    """Write a file to the disk and drop it from memory, so that reading it back reads the disk."""
    sync_file(path)
    with path.open("rb") as stream:
        _drop_cache(stream.fileno())


def _drop_cache(descriptor: int) -> None:
    """Start writing a file's cached pages, and drop those that are written."""
    if hasattr(os, "posix_fadvise"):
        os.posix_fadvise(descriptor, 0, 0, os.POSIX_FADV_DONTNEED)
