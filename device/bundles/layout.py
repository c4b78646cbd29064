"""Places of bundles, the same plain folders on the device and in the library, and their publishing in one step."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Generic, Literal, TypeVar

from device.bundles.record import FileEntry, checksum_name, describe_file, manifest_checksum
from device.errors import RecordError, StoreError
from device.io.atomic import publish_directory, remove_tree_quietly
from device.io.folder import Folder, FolderEntry
from device.io.lock import locked_directory
from device.io.system import set_store_modes

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
