"""Reading and writing in a folder that somebody else controls: a memory card, a mount, a group-writable folder.

Every access starts at an open descriptor of the folder and walks down one name at a time. Links are never followed,
only regular files are read, opening never waits for a writer, every read has a size limit, and a file that is written
is always a new one that takes its final name in one step. Whatever the other side swaps meanwhile, nothing outside
the folder is read or written.
"""

from __future__ import annotations

import errno
import os
import secrets
import stat
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Final, Literal

MAX_ENTRIES: Final = 200_000
"""A folder with more entries is not a store's."""

_COPY_BYTES: Final = 1 << 20
_READ: Final = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
_DIRECTORY: Final = os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC
_NEW: Final = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC

EntryKind = Literal["folder", "file", "other"]


class IrregularFile(OSError):
    """The name is there and is no regular file: a link, folder, pipe or device."""

    def __init__(self, name: str) -> None:
        super().__init__(errno.EINVAL, "it is no regular file", name)


class FileTooLarge(OSError):
    """The file holds more than may be read."""

    def __init__(self, name: str, max_bytes: int) -> None:
        super().__init__(errno.EFBIG, f"it is larger than {max_bytes} bytes", name)


@dataclass(frozen=True, slots=True)
class FolderEntry:
    """A name in a folder and what it is, links not followed; undecodable bytes are surrogates in the name."""

    name: str
    kind: EntryKind


_NO_SYNC: Final = frozenset({errno.EINVAL, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOTTY})


def sync_descriptor(descriptor: int) -> None:
    """Return when a file's bytes or a folder's entries are on the disk, or the file system has no such operation.

    Network and shared folders (CIFS, VirtualBox, some FUSE) lack it, for folders above all: what is written there is as
    durable as the share makes it.
    """
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in _NO_SYNC:
            raise


def open_regular(path: Path, *, follow: bool = False) -> int:
    """Descriptor of a regular file for reading. `follow`: the last name may be a link, as the user named it.

    Raises
    ------
    OSError
        It does not exist, it may not be read, or it is something else (`IrregularFile`).
    """
    return _open_regular(str(path), str(path), None, follow=follow)


class Folder:
    """An open folder; a context manager. Places are relative, with "/" between their parts.

    Every method raises OSError; nothing outside the folder is ever touched.

    Parameters
    ----------
    path : the folder itself may be reached through links when `follow` is True; nothing below it may
    """

    def __init__(self, path: Path, *, follow: bool = True) -> None:
        self.path = path
        self._descriptor = os.open(path, _DIRECTORY if follow else _DIRECTORY | os.O_NOFOLLOW)

    def __enter__(self) -> Folder:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        os.close(self._descriptor)

    def entries(self, place: str = "") -> list[FolderEntry]:
        """Return what a folder holds, sorted by name; more than `MAX_ENTRIES` is an error."""
        found: list[FolderEntry] = []
        with self._opened(place.split("/") if place else []) as descriptor, os.scandir(descriptor) as entries:
            for entry in entries:
                found.append(FolderEntry(entry.name, _kind(entry)))
                if len(found) > MAX_ENTRIES:
                    raise OSError(errno.EFBIG, f"more than {MAX_ENTRIES} entries", place)
        return sorted(found, key=lambda entry: entry.name)

    @contextmanager
    def opened(self, place: str) -> Iterator[BinaryIO]:
        """A regular file's stream."""
        with self._parent(place) as (parent, name):
            descriptor = _open_regular(name, place, parent)
        with os.fdopen(descriptor, "rb") as stream:
            yield stream

    def read(self, place: str, max_bytes: int) -> bytes:
        """A regular file's bytes; a larger one is refused (`FileTooLarge`)."""
        with self.opened(place) as stream:
            data = stream.read(max_bytes + 1)
        if len(data) > max_bytes:
            raise FileTooLarge(place, max_bytes)
        return data

    def write(self, place: str, content: bytes | BinaryIO, mode: int = 0o666) -> None:
        """Put a new file in the place of whatever is there under that name, durable before it appears."""
        with self._parent(place) as (parent, name):
            partial = f".{name}.{secrets.token_hex(6)}.part"
            descriptor = os.open(partial, _NEW, mode, dir_fd=parent)
            try:
                with os.fdopen(descriptor, "wb") as stream:
                    if isinstance(content, bytes):
                        stream.write(content)
                    else:
                        while block := content.read(_COPY_BYTES):
                            stream.write(block)
                    stream.flush()
                    sync_descriptor(stream.fileno())
                os.rename(partial, name, src_dir_fd=parent, dst_dir_fd=parent)
            except BaseException:
                with suppress(OSError):
                    os.unlink(partial, dir_fd=parent)
                raise
            sync_descriptor(parent)

    def make_folder(self, place: str, mode: int = 0o777) -> None:
        """Make a folder; an existing folder is kept, anything else of that name is an error."""
        with self._parent(place) as (parent, name):
            try:
                os.mkdir(name, mode, dir_fd=parent)
            except FileExistsError:
                os.close(_open_directory(name, parent))

    def rename(self, place: str, new_place: str) -> None:
        """Rename a file or folder durably; a folder never replaces anything."""
        with self._parent(place) as (parent, name), self._parent(new_place) as (new_parent, new_name):
            os.rename(name, new_name, src_dir_fd=parent, dst_dir_fd=new_parent)
            sync_descriptor(new_parent)

    def remove_file(self, place: str) -> None:
        """Remove a file, or the link of that name; one that is absent is no error."""
        with suppress(FileNotFoundError), self._parent(place) as (parent, name):
            os.unlink(name, dir_fd=parent)

    @contextmanager
    def _parent(self, place: str) -> Iterator[tuple[int, str]]:
        *folders, name = place.split("/")
        if name in ("", ".", ".."):
            raise OSError(errno.EINVAL, "it is no name of a file", place)
        with self._opened(folders) as descriptor:
            yield descriptor, name

    @contextmanager
    def _opened(self, folders: list[str]) -> Iterator[int]:
        """Descriptor of a folder below this one."""
        with ExitStack() as stack:
            # A descriptor of its own: one that is shared would share its reading position, too.
            descriptor = os.open(".", _DIRECTORY, dir_fd=self._descriptor)
            stack.callback(os.close, descriptor)
            for folder in folders:
                if folder in ("", ".", ".."):
                    raise OSError(errno.EINVAL, "it is no name of a folder", folder)
                descriptor = _open_directory(folder, descriptor)
                stack.callback(os.close, descriptor)
            yield descriptor


def _open_directory(name: str, parent: int) -> int:
    return os.open(name, _DIRECTORY | os.O_NOFOLLOW, dir_fd=parent)


def _open_regular(name: str, place: str, parent: int | None, *, follow: bool = False) -> int:
    try:
        descriptor = os.open(name, _READ & ~os.O_NOFOLLOW if follow else _READ, dir_fd=parent)
    except OSError as error:
        if error.errno in (errno.ELOOP, errno.ENXIO):  # a link, or a socket
            raise IrregularFile(place) from error
        raise
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise IrregularFile(place)
    return descriptor


def _kind(entry: os.DirEntry[str]) -> EntryKind:
    try:
        if entry.is_dir(follow_symlinks=False):
            return "folder"
        return "file" if entry.is_file(follow_symlinks=False) else "other"
    except OSError:  # a bad place of the card: the entry is there, and nothing can be said about it
        return "other"
