"""One owner of the instrument at a time: a lock that the kernel drops with the process that holds it, however it ends.

libcamera keeps a second program off the camera, but only after that program has switched the first one's lights off.
The lock stands before all hardware. Simulated boards need none: each process has a world of its own.
"""

from __future__ import annotations

import fcntl
import os
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import Final

from device.errors import InstrumentBusy
from hal.board_profile import BoardProfile
from hal.hardware import Hardware, open_hardware
from hal.interfaces import Clock

SERVICE_FOLDER: Final = Path("/run/retroscan")
LOCK_FILE: Final = "instrument.lock"


@contextmanager
def owned_hardware(profile: BoardProfile, clock: Clock | None = None) -> Iterator[Hardware]:
    """The hardware that the profile names, entered, with no other program on it.

    Raises
    ------
    InstrumentBusy
        Another program has it.
    HalError
        It cannot be opened.
    """
    with sole_owner(profile), open_hardware(profile, clock) as hardware:
        yield hardware


def sole_owner(profile: BoardProfile) -> AbstractContextManager[None]:
    """Keeps other programs off a real board for as long as it is entered; a simulated one is each process's own."""
    return nullcontext() if profile.driver == "twin" else instrument_lock(lock_path(os.environ))


def lock_path(environment: Mapping[str, str], service_folder: Path = SERVICE_FOLDER) -> Path:
    """The lock's file: in the service's folder wherever there is one, else in the user's own run-time folder."""
    if service_folder.is_dir():
        return service_folder / LOCK_FILE
    own = environment.get("XDG_RUNTIME_DIR", "")
    folder = Path(own) if Path(own).is_dir() and own else Path(tempfile.gettempdir())
    return folder / f"retroscan-{os.getuid()}.lock"


@contextmanager
def instrument_lock(path: Path) -> Iterator[None]:
    """Within it no other process that asks for the same file has the instrument.

    Raises
    ------
    InstrumentBusy
        Another process has it; or the file cannot be made.
    """
    try:
        file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o660)
    except OSError as error:
        raise InstrumentBusy(
            f"{path}: the instrument cannot be locked ({error.strerror}): run this as its own user, sudo -u retroscan"
        ) from error
    try:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            owner = os.pread(file, 20, 0).decode(errors="replace").strip() or "unknown"
            raise InstrumentBusy(
                f"the instrument is in use by process {owner}: end it first "
                "(`sudo systemctl stop retroscan retroscan-tui` when it is the service)"
            ) from error
        os.ftruncate(file, 0)
        os.pwrite(file, f"{os.getpid()}\n".encode(), 0)
        yield
    finally:
        os.close(file)
