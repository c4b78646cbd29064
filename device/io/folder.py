"""Reading and writing in a folder that somebody else controls: a memory card, a mount, a group-writable folder.

Every access starts at an open descriptor of the folder and walks down one name at a time. Links are never followed,
only regular files are read, opening never waits for a writer, every read has a size limit, and a file that is written
is always a new one that takes its final name in one step. Whatever the other side swaps meanwhile, nothing outside
the folder is read or written. Where the system opens no folders (Windows), names are looked at before they are used, so
that only what another program swaps in between gets through.
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
from typing import TYPE_CHECKING, BinaryIO, Final, Literal

if TYPE_CHECKING:
    from os import _ScandirIterator as ScandirIterator

MAX_ENTRIES: Final = 200_000
"""A folder with more entries is not a store's."""

OPENS_FOLDERS: Final = hasattr(os, "O_DIRECTORY") and os.open in os.supports_dir_fd
"""Whether the system opens folders and looks names up in an open one: POSIX does, Windows does not."""

NO_FOLLOW: Final = getattr(os, "O_NOFOLLOW", 0)
"""Flag that refuses a link in place of a file; nothing where the system has none (Windows)."""

_COPY_BYTES: Final = 1 << 20
_CLOSED: Final = getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
_READ: Final = os.O_RDONLY | NO_FOLLOW | getattr(os, "O_NONBLOCK", 0) | _CLOSED
_DIRECTORY: Final = os.O_RDONLY | getattr(os, "O_DIRECTORY", 0) | _CLOSED
_NEW: Final = os.O_WRONLY | os.O_CREAT | os.O_EXCL | NO_FOLLOW | _CLOSED

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
    """Return the descriptor of a regular file for reading. `follow`: the last name may be a link, as the user named it.

    Raises
    ------
    OSError
        It does not exist, it may not be read, or it is something else (`IrregularFile`).
    """
    return _open_regular(str(path), str(path), None, follow=follow)


def open_appending(path: Path) -> int:
    """Return the descriptor of a file for reading and writing, made when absent; the last name may not be a link."""
    return os.open(path, os.O_RDWR | os.O_CREAT | (_READ & ~os.O_RDONLY), 0o666)


class Folder:
    """An open folder; a context manager. Places are relative, with "/" between their parts.

    Every method raises OSError; nothing outside the folder is ever touched.

    Parameters
    ----------
    path : the folder itself may be reached through links when `follow` is True; nothing below it may
    """

    def __init__(self, path: Path, *, follow: bool = True) -> None:
        self.path = path
        if OPENS_FOLDERS:
            self._here = _Parent(path, os.open(path, _DIRECTORY if follow else _DIRECTORY | NO_FOLLOW))
        else:
            _check_folder(path, follow=follow)
            self._here = _Parent(path, None)

    def __enter__(self) -> Folder:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._here.close()

    def entries(self, place: str = "") -> list[FolderEntry]:
        """Return what a folder holds, sorted by name; more than `MAX_ENTRIES` is an error."""
        found: list[FolderEntry] = []
        with self._opened(place.split("/") if place else []) as folder, folder.scan() as entries:
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
        """Return a regular file's bytes; a larger one is refused (`FileTooLarge`)."""
        with self.opened(place) as stream:
            data = stream.read(max_bytes + 1)
        if len(data) > max_bytes:
            raise FileTooLarge(place, max_bytes)
        return data

    def write(self, place: str, content: bytes | BinaryIO, mode: int = 0o666) -> None:
        """Put a new file in the place of whatever is there under that name, durable before it appears."""
        with self._parent(place) as (parent, name):
            partial = f".{name}.{secrets.token_hex(6)}.part"
            descriptor = os.open(parent.at(partial), _NEW, mode, dir_fd=parent.descriptor)
            try:
                with os.fdopen(descriptor, "wb") as stream:
                    if isinstance(content, bytes):
                        stream.write(content)
                    else:
                        while block := content.read(_COPY_BYTES):
                            stream.write(block)
                    stream.flush()
                    sync_descriptor(stream.fileno())
                within = parent.descriptor
                os.replace(parent.at(partial), parent.at(name), src_dir_fd=within, dst_dir_fd=within)
            except BaseException:
                with suppress(OSError):
                    os.unlink(parent.at(partial), dir_fd=parent.descriptor)
                raise
            parent.sync()

    def make_folder(self, place: str, mode: int = 0o777) -> None:
        """Make a folder; an existing folder is kept, anything else of that name is an error."""
        with self._parent(place) as (parent, name):
            try:
                os.mkdir(parent.at(name), mode, dir_fd=parent.descriptor)
            except FileExistsError:
                _open_directory(name, parent).close()

    def rename(self, place: str, new_place: str) -> None:
        """Rename a file or folder durably; a folder never replaces anything."""
        with self._parent(place) as (parent, name), self._parent(new_place) as (new_parent, new_name):
            old, new = parent.at(name), new_parent.at(new_name)
            os.rename(old, new, src_dir_fd=parent.descriptor, dst_dir_fd=new_parent.descriptor)
            new_parent.sync()

    def remove_file(self, place: str) -> None:
        """Remove a file, or the link of that name; one that is absent is no error."""
        with suppress(FileNotFoundError), self._parent(place) as (parent, name):
            os.unlink(parent.at(name), dir_fd=parent.descriptor)

    @contextmanager
    def _parent(self, place: str) -> Iterator[tuple[_Parent, str]]:
        *folders, name = place.split("/")
        if not _is_name(name):
            raise OSError(errno.EINVAL, "it is no name of a file", place)
        with self._opened(folders) as parent:
            yield parent, name

    @contextmanager
    def _opened(self, folders: list[str]) -> Iterator[_Parent]:
        """A folder below this one, opened."""
        with ExitStack() as stack:
            parent = self._here.reopened()
            stack.callback(parent.close)
            for folder in folders:
                if not _is_name(folder):
                    raise OSError(errno.EINVAL, "it is no name of a folder", folder)
                parent = _open_directory(folder, parent)
                stack.callback(parent.close)
            yield parent


@dataclass(frozen=True, slots=True)
class _Parent:
    """A folder in which names are looked up: open, or by its path where the system opens no folders.

    By path, another program may swap a folder for a link between the look at it and its use.
    """

    path: Path
    descriptor: int | None

    def at(self, name: str) -> str:
        """Return the name as a function that is given the descriptor takes it."""
        return name if self.descriptor is not None else str(self.path / name)

    def scan(self) -> ScandirIterator[str]:
        """Its entries."""
        return os.scandir(self.path) if self.descriptor is None else os.scandir(self.descriptor)

    def reopened(self) -> _Parent:
        """Return the same with a descriptor of its own: one that is shared would share its reading position, too."""
        if self.descriptor is None:
            return self
        return _Parent(self.path, os.open(".", _DIRECTORY, dir_fd=self.descriptor))

    def sync(self) -> None:
        """Return when its entries are on the disk, where the system can say so."""
        if self.descriptor is not None:
            sync_descriptor(self.descriptor)

    def close(self) -> None:
        """Close the descriptor, if there is one."""
        if self.descriptor is not None:
            os.close(self.descriptor)


def _is_name(name: str) -> bool:
    """Return whether a part of a place is the name of one thing in a folder."""
    return name not in ("", ".", "..") and (OPENS_FOLDERS or not set(name) & set("\\:"))


def _open_directory(name: str, parent: _Parent) -> _Parent:
    path = parent.path / name
    if parent.descriptor is None:
        _check_folder(path, follow=False)
        return _Parent(path, None)
    return _Parent(path, os.open(name, _DIRECTORY | NO_FOLLOW, dir_fd=parent.descriptor))


def _check_folder(path: Path, *, follow: bool) -> None:
    """Refuse what is no folder, as opening it would."""
    facts = path.stat() if follow else path.lstat()
    if _is_link(facts):
        raise OSError(errno.ELOOP, os.strerror(errno.ELOOP), str(path))
    if not stat.S_ISDIR(facts.st_mode):
        raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(path))


def _is_link(facts: os.stat_result) -> bool:
    """Return whether it is a symbolic link, or a junction of Windows."""
    reparse = getattr(stat, "FILE_ATTRIBUTE_REPARSE_POINT", 0) & getattr(facts, "st_file_attributes", 0)
    return stat.S_ISLNK(facts.st_mode) or bool(reparse)


def _open_regular(name: str, place: str, parent: _Parent | None, *, follow: bool = False) -> int:
    path = name if parent is None else parent.at(name)
    if not OPENS_FOLDERS and not follow and not stat.S_ISREG(os.lstat(path).st_mode):
        raise IrregularFile(place)
    flags = _READ & ~NO_FOLLOW if follow else _READ
    try:
        descriptor = os.open(path, flags, dir_fd=None if parent is None else parent.descriptor)
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
