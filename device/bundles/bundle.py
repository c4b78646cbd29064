"""Common part of scan and calibration bundles: their places, files, publishing and receipts.

A bundle is a plain folder with a record, the same on the device and in the library; it is published in one step.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Generic, Literal, Protocol, TypeVar

from device.bundles.raw_frame import read_bundle_frame
from device.bundles.record import (
    MAX_MANIFEST_BYTES,
    BundleId,
    FileEntry,
    Identity,
    Record,
    Sha256,
    ShortText,
    Time,
    check_folder_name,
    checksum_name,
    decode_record,
    describe_file,
    manifest_checksum,
    read_manifest,
    sha256_bytes,
    verify_files,
)
from device.errors import RecordError, StoreError
from device.io.atomic import publish_directory, remove_tree_quietly
from device.io.folder import Folder, FolderEntry
from device.io.lock import locked_directory
from device.io.system import set_store_modes
from device.io.tiff import check_pixel_count
from hal.frame import RawFrame

RAW_OVERHEAD_BYTES: Final = 1 << 20
"""What a raw file may need beside its counts: header and tables."""


class Manifest(Protocol):
    """Common fields of the records of both kinds of bundle."""

    @property
    def identity(self) -> Identity:
        """Identity of the bundle."""
        ...

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W) of every raw frame, sensor pixels."""
        ...

    @property
    def files(self) -> dict[str, FileEntry]:
        """Hash and size of every file beside the manifest."""
        ...

    @property
    def raw_files(self) -> tuple[str, ...]:
        """Names of the raw frames."""
        ...

    @property
    def named_files(self) -> tuple[str, ...]:
        """Every file that the record refers to."""
        ...


ManifestT = TypeVar("ManifestT", bound=Manifest)


@dataclass(frozen=True, slots=True)
class Bundle(Generic[ManifestT]):
    """A published bundle: its directory and its record; frames are read when they are used."""

    directory: Path
    record: ManifestT

    @property
    def bundle_id(self) -> str:
        """Id of the bundle, also the name of its directory."""
        return self.record.identity.id

    def path(self, name: str) -> Path:
        """Return the path of a file of the bundle.

        Raises
        ------
        RecordError
            The manifest lists no such file.
        """
        if name not in self.record.files:
            raise RecordError(f"{self.directory}: holds no file {name!r}: its files are {', '.join(self.record.files)}")
        return self.directory / name

    def verify(self) -> None:
        """Hash every file and compare.

        Raises
        ------
        RecordError
            Names every file that is missing or differs.
        """
        verify_files(self.directory, self.record.files)

    def _frame(self, name: str) -> RawFrame:
        """Return a raw frame of the bundle, read from disk.

        Raises
        ------
        RecordError
            The file is missing or damaged, or of another size than the record states.
        """
        return read_bundle_frame(self.path(name), self.record.shape)


def check_files(record: Manifest, source: str | Path) -> None:
    """Refuse a record that refers to files it does not list, or states sizes that no honest device writes.

    Raises
    ------
    RecordError
        Names `source` and the files.
    """
    unlisted = [name for name in record.named_files if name not in record.files]
    if unlisted:
        raise RecordError(f"{source}: files: {', '.join(unlisted)} is not listed there: fetch it again")
    try:
        check_pixel_count(record.shape)
    except ValueError as error:
        raise RecordError(f"{source}: shape: {error}: fetch it again") from error
    rows, columns = record.shape
    limit = 2 * rows * columns * 9 // 8 + RAW_OVERHEAD_BYTES
    for name in record.raw_files:
        size = record.files[name].size
        if size > limit:
            raise RecordError(
                f"{source}: {name} states {size} bytes, too many for {columns}x{rows} pixels: fetch it again"
            )


def read_record(directory: Path, manifest: str, decode: Callable[[bytes, Path], ManifestT]) -> ManifestT:
    """Return the record of the bundle in a directory; its manifest is checked, its other files are not read.

    Raises
    ------
    RecordError
        No such bundle there, an unknown version, a damaged manifest, or a folder not named by the bundle's id.
    """
    record = decode(read_manifest(directory, manifest), directory / manifest)
    check_folder_name(directory, record.identity)
    return record


BundleKind = Literal["scans", "calibrations"]
MANIFESTS: Final[dict[BundleKind, str]] = {"scans": "scan.json", "calibrations": "calibration.json"}
PARTIAL_SUFFIX: Final = ".partial"
INBOX: Final = "inbox"
"""Folder of the device's store for calibrations that a workstation pushed."""

_BUNDLE_ID: Final = re.compile(r"[a-z0-9][a-z0-9-]{0,99}")

BundleT = TypeVar("BundleT")


@dataclass(frozen=True, slots=True)
class DamagedBundle:
    """A bundle, or an entry among the bundles, that cannot be read, and why in one sentence."""

    directory: Path
    reason: str


@dataclass(frozen=True, slots=True)
class Listing(Generic[BundleT]):
    """Bundles in order of their ids, and the damaged ones."""

    bundles: tuple[BundleT, ...]
    damaged: tuple[DamagedBundle, ...]


@dataclass(frozen=True, slots=True)
class BundleNames:
    """Ids of published bundles, sorted, and names of entries that look like bundles and cannot be."""

    ids: tuple[str, ...]
    passed_over: tuple[str, ...]


def partial_name(bundle_id: str) -> str:
    """Name of the temporary directory in which a bundle grows until it is published."""
    return f".{bundle_id}{PARTIAL_SUFFIX}"


def is_bundle_id(name: str) -> bool:
    """Return whether a directory of this name can be a bundle."""
    return _BUNDLE_ID.fullmatch(name) is not None


def bundle_names(entries: Iterable[FolderEntry]) -> BundleNames:
    """Return the bundles among the entries of a folder of bundles.

    Hidden entries are ignored, and so are ordinary files of other names, such as a file manager's. Passed over are
    folders and special files that are no bundle, bundle ids that are no folder, and names that are not UTF-8.
    """
    ids, passed_over = [], []
    for entry in entries:
        fits = is_bundle_id(entry.name)
        if fits and entry.kind == "folder":
            ids.append(entry.name)
        elif fits or (not entry.name.startswith(".") and (entry.kind != "file" or not is_utf_8(entry.name))):
            passed_over.append(entry.name)
    return BundleNames(tuple(sorted(ids)), tuple(sorted(passed_over)))


def is_utf_8(name: str) -> bool:
    """Return whether a file's name was valid UTF-8."""
    return not any("\ud800" <= letter <= "\udfff" for letter in name)


def bundle_ids(root: Path, kind: BundleKind) -> list[str]:
    """Return ids of the published bundles under a root, sorted; none when there is no such folder.

    Raises
    ------
    OSError
        The folder exists and cannot be read, or is not a folder.
    """
    try:
        with Folder(root / kind) as folder:
            return list(bundle_names(folder.entries()).ids)
    except FileNotFoundError:
        if (root / kind).is_symlink():
            raise
        return []


def list_bundles(root: Path, kind: BundleKind, read: Callable[[Path], BundleT]) -> Listing[BundleT]:
    """Return every published bundle under a root, read by `read`."""
    bundles, damaged = [], []
    for bundle_id in bundle_ids(root, kind):
        directory = root / kind / bundle_id
        try:
            bundles.append(read(directory))
        except RecordError as error:
            damaged.append(DamagedBundle(directory, str(error)))
    return Listing(tuple(bundles), tuple(damaged))


# Publishing: a bundle grows in a temporary directory and appears under its name in one step. A writer locks its
# temporary directory. So a start removes what a power cut left, and nothing that is being written.

FileWriter = Callable[[Path], None]
ManifestBuilder = Callable[[dict[str, FileEntry]], bytes]


def publish_bundle(root: Path, kind: BundleKind, bundle_id: str, write: FileWriter, manifest: ManifestBuilder) -> Path:
    """Write a bundle into a temporary directory, publish it, and return the published directory.

    write : puts the bundle's files into a directory
    manifest : turns the files' hashes into the manifest

    Raises
    ------
    RecordError
        The id cannot name a directory.
    StoreError
        The id is taken.
    OSError
        The disk refused; nothing is left behind.
    """
    if not is_bundle_id(bundle_id):
        raise RecordError(f"{bundle_id!r} is no bundle id: an id consists of lower-case letters, digits and hyphens")
    final = root / kind / bundle_id
    partial = root / kind / partial_name(bundle_id)
    with ExitStack() as stack:
        with locked_directory(root):
            if final.exists() or partial.exists():
                raise StoreError(f"{final}: exists already, and a bundle is never overwritten: start the program again")
            stack.callback(remove_tree_quietly, partial)
            partial.mkdir()
            stack.enter_context(locked_directory(partial))
        write(partial)
        name = MANIFESTS[kind]
        data = manifest({path.name: describe_file(path) for path in sorted(partial.iterdir())})
        (partial / name).write_bytes(data)
        (partial / checksum_name(name)).write_bytes(manifest_checksum(name, data))
        set_store_modes(partial)
        with locked_directory(root):
            publish_directory(partial, final)
    return final


def clear_unpublished(root: Path) -> None:
    """Remove temporary directories that no running program writes."""
    for kind in MANIFESTS:
        for partial in (root / kind).glob(f".*{PARTIAL_SUFFIX}"):
            # A locked one is being written; one that cannot be opened is never listed, and so harmless.
            with suppress(OSError), locked_directory(partial, wait=False):
                remove_tree_quietly(partial)


# Receipts of bundles.

RECEIPT_SCHEMA: Final = "retrograph.receipt/1"

RECEIPTS: Final = "receipts"

_SUFFIX: Final = ".json"


class Receipt(Record, frozen=True, tag_field="schema", tag=RECEIPT_SCHEMA):
    """A workstation's statement that it stored a bundle, read it back and found every byte as promised.

    Only a receipt allows a device to delete a scan, and only when it names the kind, the id and the very manifest that
    the device holds.

    manifest_sha256 : hash of the manifest, which holds the hash of every file
    host : the workstation's name, for people
    verified : by the workstation's clock; an annotation
    """

    kind: BundleKind
    bundle_id: BundleId
    manifest_sha256: Sha256
    host: ShortText
    verified: Time


def receipt_name(bundle_id: str) -> str:
    """Name of the file that holds a bundle's receipt."""
    return bundle_id + _SUFFIX


def receipted_bundle(receipt_file: str) -> str | None:
    """Return the id of the bundle that a receipt's file name states; None for any other file.

    The name alone proves nothing.
    """
    return receipt_file.removesuffix(_SUFFIX) if receipt_file.endswith(_SUFFIX) else None


def is_receipted(root: Path, kind: BundleKind, bundle_id: str, manifest: bytes) -> bool:
    """Return whether a receipt in a store names this kind, id and manifest; an unreadable receipt counts as absent.

    The folder of receipts is writable for workstations: nothing in it is trusted.
    """
    try:
        with Folder(root) as folder:
            data = folder.read(f"{RECEIPTS}/{receipt_name(bundle_id)}", MAX_MANIFEST_BYTES)
        receipt = decode_record(data, Receipt, receipt_name(bundle_id))
    except (OSError, RecordError):
        return False
    return (receipt.kind, receipt.bundle_id, receipt.manifest_sha256) == (kind, bundle_id, sha256_bytes(manifest))
