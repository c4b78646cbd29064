"""The lock of a folder: the system's where the file system has locks, otherwise a lease file with owner and age.

Where the system locks no folders (Windows), a file in or beside the folder is locked instead.
"""

from __future__ import annotations

import errno
import json
import os
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from device.io.folder import open_regular

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

LEASE_S: Final = 24 * 3600.0
"""A lease of another computer that is older than this is taken over."""

LEASE_SUFFIX: Final = ".lease"
LOCK_SUFFIX: Final = ".lock"
_NO_LOCKS: Final = frozenset({errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS})
_GUARD_S: Final = 60.0
_POLL_S: Final = 0.2
_MAX_BYTES: Final = 4096


class FolderLocked(BlockingIOError):
    """Another program holds the lock; `strerror` says which, as far as that is known."""

    def __init__(self, owner: str, path: Path) -> None:
        super().__init__(errno.EWOULDBLOCK, owner, str(path))


@contextmanager
def locked_directory(
    directory: Path, *, wait: bool = True, sleep: Callable[[float], None] = time.sleep
) -> Iterator[None]:
    """Holds the lock of a directory; it ends with the process at the latest.

    Where the file system has no locks, such as some network shares, a lease file takes their place: it is taken over
    when its program on this computer is gone, or after a day.

    Raises
    ------
    FolderLocked
        Another program holds it and `wait` is False.
    """
    if fcntl is None:
        with _locked_by_file(directory, wait=wait):
            yield
        return
    descriptor = os.open(directory, os.O_RDONLY | os.O_DIRECTORY)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise FolderLocked("another program holds its lock", directory) from error
        except OSError as error:
            if error.errno not in _NO_LOCKS:
                raise
            with _leased(_companion(directory, LEASE_SUFFIX), sleep if wait else None):
                yield
            return
        yield
    finally:
        os.close(descriptor)


def _companion(directory: Path, suffix: str) -> Path:
    """Return a file inside a folder that stays; beside a temporary one, whose content is published."""
    hidden = directory.name.startswith(".")
    return directory.with_name(directory.name + suffix) if hidden else directory / f".retrograph{suffix}"


@contextmanager
def _locked_by_file(directory: Path, *, wait: bool) -> Iterator[None]:
    """Hold the lock of a folder's companion file, which the system frees when the process ends."""
    from filelock import FileLock, Timeout  # here, because a system that locks folders does without it

    if not directory.is_dir():
        absent = errno.ENOTDIR if directory.exists() else errno.ENOENT
        raise OSError(absent, os.strerror(absent), str(directory))
    path = _companion(directory, LOCK_SUFFIX)
    lock = FileLock(path, timeout=-1 if wait else 0)
    try:
        lock.acquire()
    except Timeout as error:
        raise FolderLocked("another program holds its lock", directory) from error
    try:
        yield
    finally:
        lock.release()
        with suppress(OSError):  # another program may hold it by now
            path.unlink()


@contextmanager
def _leased(path: Path, sleep: Callable[[float], None] | None) -> Iterator[None]:
    own = json.dumps({"host": socket.gethostname(), "pid": os.getpid(), "time": round(time.time())}).encode()
    while not _create(path, own):
        owner = _owner(path)
        if owner is None:
            _remove_stale(path)
        elif sleep is None:
            raise FolderLocked(f"{owner}; remove {path} if that program no longer runs", path)
        else:
            sleep(_POLL_S)
    try:
        yield
    finally:
        with suppress(FileNotFoundError):
            path.unlink()


def _create(path: Path, content: bytes) -> bool:
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)
    except FileExistsError:
        return False
    with os.fdopen(descriptor, "wb") as stream:
        stream.write(content)
    return True


def _remove_stale(path: Path) -> None:
    """Remove a lease without a holder; a guard file keeps two programs from doing that to each other's new lease."""
    guard = path.with_name(f"{path.name}-takeover")
    if _create(guard, b""):
        try:
            if path.exists() and _owner(path) is None:
                path.unlink()
        finally:
            guard.unlink()
    else:
        with suppress(FileNotFoundError):
            if time.time() - guard.lstat().st_mtime > _GUARD_S:
                guard.unlink()


def _owner(path: Path) -> str | None:
    """Who holds a lease and for how long; None when it is free."""
    try:
        age_s = time.time() - path.lstat().st_mtime
        with os.fdopen(open_regular(path), "rb") as stream:
            found = json.loads(stream.read(_MAX_BYTES))
        host, pid = str(found["host"]), int(found["pid"])
    except FileNotFoundError:
        return None
    except (ValueError, KeyError, TypeError, OSError):
        return "an unreadable lease file is there"  # its program may be writing it right now
    if age_s > LEASE_S or (host == socket.gethostname() and not _runs(pid)):
        return None
    return f"program {pid} on {host} has held it for {age_s:.0f} s"


def _runs(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except (PermissionError, OverflowError):
        return True
    return True
