"""A source that is a folder: a card, a mount, or a store on this machine."""

from __future__ import annotations

import os
import stat
from pathlib import Path
from typing import BinaryIO, Final

from device.bundle_layout import MANIFESTS, BundleKind, bundle_ids
from host_sync.errors import SourceError

_USUAL_PLACES: Final = ("retroscan", "var/lib/retroscan")


class DirectorySource:
    """A store's folder, or a card or mount that contains one.

    Raises
    ------
    SourceError
        There is no store, or more than one.
    """

    def __init__(self, path: Path) -> None:
        self.root = _locate_store(path)

    @property
    def name(self) -> str:
        """The store's folder."""
        return str(self.root)

    def bundle_ids(self, kind: BundleKind) -> list[str]:
        """Ids of the published bundles, sorted."""
        try:
            return bundle_ids(self.root, kind)
        except OSError as error:
            raise SourceError(f"{self.root / kind}: cannot be read ({error.strerror}): connect it again") from error

    def open_file(self, kind: BundleKind, bundle_id: str, file_name: str) -> BinaryIO:
        """One regular file of a bundle; a link is not followed."""
        path = self.root / kind / bundle_id / file_name
        try:
            descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
        except OSError as error:
            raise SourceError(f"{path}: cannot be read ({error.strerror}): fetch the bundle again") from error
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            os.close(descriptor)
            raise SourceError(f"{path}: is no regular file: fetch the bundle again")
        return os.fdopen(descriptor, "rb")


def _locate_store(path: Path) -> Path:
    """The one store at or under a path."""
    try:
        found = _stores(path)
    except OSError as error:
        raise SourceError(f"{path}: cannot be read ({error.strerror}): connect it again or name another") from error
    if not found:
        raise SourceError(f"{path}: holds no scans and no calibrations: name the folder that contains `scans`")
    if len(found) > 1:
        raise SourceError(f"{path}: holds several stores, name one: {', '.join(map(str, found))}")
    return found[0]


def _stores(path: Path) -> list[Path]:
    """The path itself when it is a store, else the stores in its usual places and just below it."""
    if _is_store(path):
        return [path]
    children = [child for child in path.iterdir() if child.is_dir() and not child.is_symlink()]
    places = {path / place for place in _USUAL_PLACES} | set(children)
    return sorted(place for place in places if _is_store(place))


def _is_store(path: Path) -> bool:
    return any((path / kind).is_dir() for kind in MANIFESTS)
