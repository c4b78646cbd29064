"""The address of each folder that was viewed: it stays from run to run, so that links to it can be kept."""

from __future__ import annotations

import http.client
from pathlib import Path
from typing import Final

import msgspec

from device.io.atomic import replace_file
from host_sync.errors import LibraryError
from host_sync.offload.paired_devices import default_devices_folder
from host_sync.viewer.access import Access

FILE: Final = "viewer.json"
ANSWER_S: Final = 2.0


class _Address(msgspec.Struct, frozen=True):
    """Credentials of a folder's page."""

    port: int
    code: str
    random_name: str


def kept_access(folder: Path, host: str) -> Access | None:
    """The credentials with which a folder was viewed last; None where it was not, or they cannot be read."""
    kept = _read().get(str(folder.resolve()))
    return Access(host, kept.port, kept.code, kept.random_name) if kept else None


def keep_access(folder: Path, access: Access) -> bool:
    """Keep the credentials of a folder, readable by this user only; False where the settings cannot be written."""
    every = _read() | {str(folder.resolve()): _Address(access.port, access.code, access.random_name)}
    try:
        settings = default_devices_folder()
        settings.mkdir(parents=True, exist_ok=True, mode=0o700)
        replace_file(settings / FILE, msgspec.json.encode(every), 0o600)
    except (OSError, LibraryError):
        return False
    return True


def answers(access: Access) -> bool:
    """Return whether a viewer with these credentials runs already."""
    connection = http.client.HTTPConnection("127.0.0.1", access.port, timeout=ANSWER_S)
    try:
        headers = {"Host": access.origin.removeprefix("http://"), "Cookie": f"{access.cookie}={access.token}"}
        connection.request("GET", "/api/palettes", headers=headers)
        return connection.getresponse().status == 200
    except (OSError, http.client.HTTPException):
        return False
    finally:
        connection.close()


def _read() -> dict[str, _Address]:
    try:
        return msgspec.json.decode((default_devices_folder() / FILE).read_bytes(), type=dict[str, _Address])
    except (OSError, LibraryError, msgspec.DecodeError, UnicodeDecodeError):
        return {}
