"""Places of bundles: the same plain folders in the device's store and in the workstation's library."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Generic, Literal, TypeVar

from device.errors import RecordError
from device.io.folder import Folder, FolderEntry

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
