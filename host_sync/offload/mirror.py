"""A verified copy of a library's bundles elsewhere, with only what is missing copied, and repair from such copies."""

from __future__ import annotations

import asyncio
import hashlib
import posixpath
import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import asyncssh

from device.bundles.bundle import MANIFESTS, BundleKind, partial_name
from device.bundles.record import CHUNK_BYTES, FileEntry, checksum_name, describe_file, sha256_bytes
from device.errors import DeviceError, RecordError
from device.io.atomic import RESULTS
from device.io.system import explain_os_error
from host_sync.errors import HostError, LibraryError, SourceError, SourceLost
from host_sync.library.library import AnyBundle, Library
from host_sync.library.verification import Verification, verify_library
from host_sync.offload.bundle_transfer import RemoteBundle, download, read_remote_bundle, verify
from host_sync.offload.ingest import PullFailure
from host_sync.offload.pull import pull
from host_sync.offload.source import DirectorySource, Source

_CONNECT_S: Final = 20.0
_REQUEST_BYTES: Final = 1 << 18


@dataclass(frozen=True, slots=True)
class MirrorReport:
    """Outcome of mirroring, by ids: copied and verified there, there already, or failed."""

    copied: tuple[str, ...]
    already_there: tuple[str, ...]
    failed: tuple[PullFailure, ...]


@dataclass(frozen=True, slots=True)
class SftpPlace:
    """A folder on an SFTP server: sftp://[user@]host[:port]/path."""

    user: str | None
    host: str
    port: int
    path: str

    @classmethod
    def parse(cls, text: str) -> SftpPlace | None:
        """Return the place, None when the text is no sftp address.

        Raises
        ------
        HostError
            It begins like one and is not one.
        """
        if not text.startswith("sftp://"):
            return None
        found = re.fullmatch(r"sftp://(?:([^@/:]+)@)?(\[[^]]+\]|[^@/:]+)(?::(\d{1,5}))?(/.+)", text)
        if found is None:
            raise HostError(f"{text!r} is no address: write sftp://USER@HOST:PORT/FOLDER")
        return cls(found[1], found[2].strip("[]"), int(found[3] or 22), found[4].rstrip("/"))


def mirror_to_folder(
    library: Library, destination: Path, report_progress: Callable[[str], None], *, verify: bool = False
) -> MirrorReport:
    """Copy what a library on another disk lacks.

    verify : hash again what is there already

    Raises
    ------
    LibraryError
        The destination cannot be written.
    """
    library.require()
    if destination.resolve().is_relative_to(library.root.resolve()):
        raise HostError(f"{destination}: is the library itself, or inside it: name another folder")
    source = DirectorySource(library.root)
    report = pull(
        source, Library(destination), lambda state: report_progress(state.bundle_id), verify=verify, trust_record=True
    )
    if report.lost is not None:
        raise SourceError(report.lost)
    return MirrorReport(tuple(report.copied), tuple(report.already_there), tuple(report.failed))


def mirror_to_sftp(
    library: Library, place: SftpPlace, report_progress: Callable[[str], None], *, verify: bool = False
) -> MirrorReport:
    """Copy what a folder on an SFTP server lacks; each file is read back from there and hashed.

    The user's own SSH configuration, keys and known hosts apply.

    Raises
    ------
    SourceError
        The server cannot be reached or refuses.
    """
    bundles = library.bundles().bundles
    try:
        return asyncio.run(_mirror(bundles, place, report_progress, verify=verify))
    except (asyncssh.Error, OSError) as error:
        raise SourceError(
            f"sftp://{place.host}{place.path}: {str(error) or 'no answer'}: check address and key"
        ) from error


async def _mirror(
    bundles: Sequence[AnyBundle], place: SftpPlace, report_progress: Callable[[str], None], *, verify: bool
) -> MirrorReport:
    copied, there, failed = list[str](), list[str](), list[PullFailure]()
    options = {} if place.user is None else {"username": place.user}
    async with (
        asyncssh.connect(
            place.host, place.port, connect_timeout=_CONNECT_S, keepalive_interval=5, **options
        ) as connection,
        connection.start_sftp_client() as client,
    ):
        for kind in MANIFESTS:
            await client.makedirs(f"{place.path}/{kind}", exist_ok=True)
        for bundle in bundles:
            report_progress(bundle.bundle_id)
            try:
                done = await _mirror_one(client, bundle, place.path, verify=verify)
                (copied if done else there).append(bundle.bundle_id)
            except (RecordError, asyncssh.SFTPError) as error:
                if isinstance(error, asyncssh.SFTPConnectionLost | asyncssh.SFTPNoConnection):
                    raise
                failed.append(PullFailure(bundle.bundle_id, str(error)))
    return MirrorReport(tuple(copied), tuple(there), tuple(failed))


async def _mirror_one(client: asyncssh.SFTPClient, bundle: AnyBundle, root: str, *, verify: bool) -> bool:
    """Copy a bundle; return False when the server has it."""
    kind: BundleKind = "scans" if bundle.directory.parent.name == "scans" else "calibrations"
    final, partial = (f"{root}/{kind}/{name}" for name in (bundle.bundle_id, partial_name(bundle.bundle_id)))
    bundle.verify()
    files = dict(bundle.record.files)
    for name in (MANIFESTS[kind], checksum_name(MANIFESTS[kind])):
        files[name] = describe_file(bundle.directory / name)
    if await client.exists(final):
        await _check_there(client, final, files, whole=verify)
        return False
    with suppress(asyncssh.SFTPNoSuchFile):
        await client.rmtree(partial)
    await client.mkdir(partial)
    for name, entry in files.items():
        await _upload(client, bundle.directory / name, posixpath.join(partial, name))
        await _check_remote(client, posixpath.join(partial, name), entry)
    await client.posix_rename(partial, final)
    return True


async def _check_there(client: asyncssh.SFTPClient, folder: str, files: dict[str, FileEntry], *, whole: bool) -> None:
    for name, entry in files.items():
        path = posixpath.join(folder, name)
        small = name.endswith((".json", ".json.sha256"))
        if (await client.lstat(path)).size != entry.size:
            raise RecordError(f"{path}: has another size there: move its folder away and mirror again")
        if whole or small:
            await _check_remote(client, path, entry)


async def _check_remote(client: asyncssh.SFTPClient, path: str, entry: FileEntry) -> None:
    digest, size = hashlib.sha256(), 0
    async with client.open(path, "rb") as file:
        while size <= entry.size:
            block: bytes = await file.read(_REQUEST_BYTES)
            if not block:
                break
            digest.update(block)
            size += len(block)
    if (size, digest.hexdigest()) != (entry.size, entry.sha256):
        raise RecordError(f"{path}: is damaged there: move its folder away and mirror again")


async def _upload(client: asyncssh.SFTPClient, path: Path, target: str) -> None:
    try:
        with path.open("rb") as stream:
            async with client.open(target, "xb") as file:
                while block := stream.read(CHUNK_BYTES):
                    await file.write(block)
                with suppress(asyncssh.SFTPOpUnsupported):
                    await file.fsync()
    except OSError as error:
        if isinstance(error, asyncssh.SFTPError):
            raise
        raise RecordError(f"{path}: cannot be read {explain_os_error(error)}") from error


# Repairing a library: lost and damaged bundles are fetched again from a card, a device or a second library.


@dataclass(frozen=True, slots=True)
class RepairReport:
    """Outcome of a repair, by ids.

    repaired : fetched again, verified and published
    failed : lost or damaged, and not repaired, with the reason
    before : the verification that the repair started from
    """

    repaired: tuple[str, ...]
    failed: tuple[PullFailure, ...]
    before: Verification


def repair(
    library: Library, sources: Sequence[Source], report_progress: Callable[[str], None] = lambda _: None
) -> RepairReport:
    """Fetch every lost or damaged bundle again; the damaged copy moves to `set-aside`, its results stay with the scan.

    A bundle is only accepted with the manifest that the library's intake record names.

    Raises
    ------
    LibraryError
        The library cannot be read or written.
    """
    with library.writing():
        before = verify_library(library, report_progress)
        repaired, failed = [], []
        for bundle in (*before.lost, *before.damaged):
            kind: BundleKind = "scans" if bundle.directory.parent.name == "scans" else "calibrations"
            name = bundle.directory.name
            report_progress(name)
            reasons = [bundle.reason]
            for source in sources:
                try:
                    _replace(library, source, kind, name, bundle.reason)
                except SourceLost:
                    raise
                except (DeviceError, HostError) as error:
                    if isinstance(error, LibraryError):
                        raise
                    reasons.append(str(error))
                else:
                    repaired.append(name)
                    break
            else:
                failed.append(PullFailure(name, "; ".join(reasons)))
    return RepairReport(tuple(repaired), tuple(failed), before)


def _replace(library: Library, source: Source, kind: BundleKind, bundle_id: str, reason: str) -> None:
    offer = read_remote_bundle(source, kind, bundle_id)
    entry = library.intake().held.get((kind, bundle_id))
    if entry is not None and entry.manifest_sha256 != sha256_bytes(offer.manifest):
        raise RecordError(f"{source.name}: has another {kind.removesuffix('s')} under the id {bundle_id}")
    directory = library.root / kind / bundle_id
    moved: Path | None = None
    with library.publishing(kind, bundle_id, offer.files) as partial:
        _fetch(source, offer, partial)
        if directory.exists() or directory.is_symlink():
            moved = library.move_aside(kind, bundle_id, reason)
    library.record("taken-in", kind, bundle_id, offer.manifest, source.name)
    if moved is not None and (moved / RESULTS).is_dir():
        with library.translating("written"):
            (moved / RESULTS).rename(directory / RESULTS)


def _fetch(source: Source, offer: RemoteBundle, partial: Path) -> None:
    def ignore(size_bytes: int, *, fetched: bool) -> None:
        """A repair shows bundles, not bytes."""

    download(source, offer, partial, ignore, {})
    verify(offer, partial)
