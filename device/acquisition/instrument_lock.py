"""One program at a time on the instrument: a lock that the kernel releases when its process ends, however it ends.

libcamera keeps a second program off the camera, but only after that program has switched the first one's lights off;
so the lock is taken before any hardware. Simulated boards need none: each process has its own.
"""

from __future__ import annotations

import fcntl
import os
import warnings
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import Final

import platformdirs

from device.errors import InstrumentBusy
from device.store.device_id import DEVICE
from hal.board_profile import BoardProfile
from hal.factory import open_hardware
from hal.hardware import Hardware
from hal.interfaces import Clock

SERVICE_FOLDER: Final = Path("/run/retroscan")
LOCK_FILE: Final = "instrument.lock"


@contextmanager
def open_exclusive(profile: BoardProfile, clock: Clock | None = None, store: Path | None = None) -> Iterator[Hardware]:
    """The hardware of a profile, opened with no other program on it.

    store : folder of its scans: the twin's noise and placement are then others after each of them

    Raises
    ------
    InstrumentBusy
        Another program uses it.
    HalError
        It cannot be opened.
    """
    with exclusive_instrument(profile), open_hardware(profile, clock, _seed(profile, store)) as hardware:
        yield hardware


def _seed(profile: BoardProfile, store: Path | None) -> int | None:
    """Return the seed of a twin whose store holds scans already; None leaves the profile's."""
    device = DEVICE.read(store) if store is not None and profile.twin is not None else None
    return None if device is None or profile.twin is None else profile.twin.seed + device.counter


def exclusive_instrument(profile: BoardProfile) -> AbstractContextManager[None]:
    """Context that keeps other programs off a real board; nothing for a simulated one."""
    return nullcontext() if profile.driver == "twin" else instrument_lock(lock_path())


def lock_path(service_folder: Path = SERVICE_FOLDER) -> Path:
    """Return the path of the lock file: in the service's folder if it exists, else in the user's runtime folder.

    Raises
    ------
    InstrumentBusy
        The user's runtime folder cannot be created.
    """
    if service_folder.is_dir():
        return service_folder / LOCK_FILE
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a session without XDG_RUNTIME_DIR is usual on a board
        try:
            folder = platformdirs.user_runtime_path(ensure_exists=True)
        except OSError as error:
            raise InstrumentBusy(_not_locked(error.filename or "the runtime folder", error)) from error
    return folder / f"retroscan-{os.getuid()}.lock"


@contextmanager
def instrument_lock(path: Path) -> Iterator[None]:
    """Context that holds the lock.

    Raises
    ------
    InstrumentBusy
        Another process holds it, or the file cannot be created.
    """
    try:
        file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o660)
    except OSError as error:
        raise InstrumentBusy(_not_locked(path, error)) from error
    try:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            owner = os.pread(file, 20, 0).decode(errors="replace").strip() or "unknown"
            raise InstrumentBusy(
                f"the instrument is in use by process {owner}: end it first "
                "(`sudo systemctl stop retroscan retroscan-tui` if it is the service)"
            ) from error
        os.ftruncate(file, 0)
        os.pwrite(file, f"{os.getpid()}\n".encode(), 0)
        yield
    finally:
        os.close(file)


def _not_locked(path: object, error: OSError) -> str:
    why = error.strerror or str(error)
    return f"{path}: the instrument cannot be locked ({why}): run this as its own user, sudo -u retroscan"
