"""Where bundles lie: the same plain folders in the device's store and in the workstation's library."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Generic, Literal, TypeVar

import msgspec

from device.errors import RecordError
from device.records import BundleId

BundleKind = Literal["scans", "calibrations"]
MANIFESTS: Final[dict[BundleKind, str]] = {"scans": "scan.json", "calibrations": "calibration.json"}
PARTIAL_SUFFIX: Final = ".partial"

BundleT = TypeVar("BundleT")


@dataclass(frozen=True, slots=True)
class DamagedBundle:
    """A published bundle that cannot be read, and the sentence that says why."""

    directory: Path
    reason: str


@dataclass(frozen=True, slots=True)
class Listing(Generic[BundleT]):
    """Bundles in order of their ids, and those that are damaged: named, never hidden."""

    bundles: tuple[BundleT, ...]
    damaged: tuple[DamagedBundle, ...]


def partial_name(bundle_id: str) -> str:
    """Name of the temporary directory in which a bundle grows until it is published."""
    return f".{bundle_id}{PARTIAL_SUFFIX}"


def is_bundle_id(name: str) -> bool:
    """Whether a directory of this name can be a bundle."""
    try:
        msgspec.convert(name, BundleId)
    except msgspec.ValidationError:
        return False
    return True


def bundle_ids(root: Path, kind: BundleKind) -> list[str]:
    """Ids of the published bundles under a root, sorted; none when there is no such folder.

    Raises
    ------
    OSError
        The folder is there and cannot be read.
    """
    folder = root / kind
    if not folder.is_dir():
        return []
    entries = [entry for entry in folder.iterdir() if is_bundle_id(entry.name)]
    return sorted(entry.name for entry in entries if entry.is_dir() and not entry.is_symlink())


def list_bundles(root: Path, kind: BundleKind, read: Callable[[Path], BundleT]) -> Listing[BundleT]:
    """Every published bundle under a root, read by `read`."""
    bundles, damaged = [], []
    for bundle_id in bundle_ids(root, kind):
        directory = root / kind / bundle_id
        try:
            bundles.append(read(directory))
        except RecordError as error:
            damaged.append(DamagedBundle(directory, str(error)))
    return Listing(tuple(bundles), tuple(damaged))
