"""A source that is a folder: a card, a mount, or a store on this machine."""

from __future__ import annotations

import os
import shutil
import stat
from collections.abc import Generator
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from typing import IO, Final

from device.bundle_layout import MANIFESTS, BundleKind, bundle_ids
from device.disk_advice import explain_refusal
from device.durable import sync_directory
from device.records import CHUNK_BYTES
from host_sync.errors import NoSource, SourceError, SourceLost

_USUAL_PLACES: Final = ("retroscan", "var/lib/retroscan")


class DirectorySource:
    """A store's folder, or a card or mount that contains one.

    Raises
    ------
    NoSource
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
            raise SourceError(f"{self.root / kind}: cannot be read {explain_refusal(error)}") from error

    def names(self, folder: str) -> list[str]:
        """Names in a folder of the store, sorted; none when there is no such folder."""
        try:
            return sorted(entry.name for entry in (self.root / folder).iterdir())
        except FileNotFoundError:
            return []
        except OSError as error:
            raise SourceError(f"{self.root / folder}: cannot be read {explain_refusal(error)}") from error

    def blocks(self, place: str, offset_bytes: int = 0) -> Generator[bytes, None, None]:
        """A regular file's bytes; a link is not followed."""
        path = self.root / place
        try:
            descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
        except OSError as error:
            raise SourceError(f"{path}: cannot be read ({error.strerror}): fetch the bundle again") from error
        with os.fdopen(descriptor, "rb") as stream:
            if not stat.S_ISREG(os.fstat(descriptor).st_mode):
                raise SourceError(f"{path}: is no regular file: fetch the bundle again")
            stream.seek(offset_bytes)
            while block := self._next_block(stream, path):
                yield block

    def write(self, place: str, data: bytes | Path) -> None:
        """Put a file there, durable before it appears under its name."""
        path = self.root / place
        partial = path.with_name(f".{path.name}.part")
        try:
            with partial.open("wb") as stream:
                with BytesIO(data) if isinstance(data, bytes) else data.open("rb") as content:
                    shutil.copyfileobj(content, stream, CHUNK_BYTES)
                stream.flush()
                os.fsync(stream.fileno())
            partial.replace(path)
            sync_directory(path.parent)
        except OSError as error:
            with suppress(OSError):
                partial.unlink(missing_ok=True)
            raise SourceError(f"{path}: cannot be written {explain_refusal(error)}") from error

    def make_folder(self, place: str) -> None:
        """Make a folder; one that is there is kept."""
        path = self.root / place
        try:
            path.mkdir(exist_ok=True)
        except OSError as error:
            raise SourceError(f"{path}: cannot be made {explain_refusal(error)}") from error

    def rename(self, place: str, new_place: str) -> None:
        """Rename a file or folder."""
        path = self.root / place
        try:
            path.rename(self.root / new_place)
            sync_directory(path.parent)
        except OSError as error:
            raise SourceError(f"{path}: cannot be renamed {explain_refusal(error)}") from error

    def clock_offset_s(self) -> None:
        """A folder has no clock."""
        return

    def _next_block(self, stream: IO[bytes], path: Path) -> bytes:
        try:
            return stream.read(CHUNK_BYTES)
        except OSError as error:
            kind = SourceError if self._is_there() else SourceLost
            raise kind(f"{path}: cannot be read {explain_refusal(error)}; then repeat") from error

    def _is_there(self) -> bool:
        """Whether the folder can still be listed: then a bad place concerns one file, else the whole card is gone."""
        try:
            return next(self.root.iterdir(), None) is not None
        except OSError:
            return False


def _locate_store(path: Path) -> Path:
    """The one store at or under a path."""
    try:
        found = _stores(path)
    except OSError as error:
        raise NoSource(f"{path}: cannot be read {explain_refusal(error)}, or name a paired device") from error
    if not found:
        raise NoSource(f"{path}: holds no scans and no calibrations: name the folder that contains `scans`")
    if len(found) > 1:
        raise NoSource(f"{path}: holds several stores, name one: {', '.join(map(str, found))}")
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
