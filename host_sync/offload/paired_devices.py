"""Devices that this workstation is paired with, and its own key: small files that only their owner can read.

<folder>/id_ed25519  <folder>/devices/<device id>.json  <folder>/synced/<device id>.json
"""

from __future__ import annotations

import os
import platform
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import Annotated, Final, TypeVar

import msgspec
import platformdirs

from device.bundles.record import BundleId, Count, Record, decode_record, encode_record, read_small
from device.io.atomic import replace_file
from device.io.os_errors import explain_os_error
from device.pairing.exchange import SshPublicKey
from host_sync.errors import HostError, LibraryError, NoSource

SECRET: Final = 0o600
_REMEDY: Final = "remove it and pair the device again"

Port = Annotated[int, msgspec.Meta(ge=1, le=65535)]
RecordT = TypeVar("RecordT", bound=Record)


class PairedDevice(Record, frozen=True, tag_field="schema", tag="retrograph.paired-device/1"):
    """A device's address and host key; the address may change, the key may not."""

    device_id: BundleId
    host: Annotated[str, msgspec.Meta(min_length=1, max_length=255)]
    port: Port
    user: Annotated[str, msgspec.Meta(pattern=r"^[a-z_][a-z0-9_-]{0,31}(?!\n)$")]
    host_key: SshPublicKey


class SyncState(Record, frozen=True, tag_field="schema", tag="retrograph.sync-state/1"):
    """Outcome of the last sync with a device.

    clock_offset_s : how far the device's clock was ahead, s; only shown
    verified : bundles of the device that the library held and had verified
    """

    device_id: BundleId
    synced: Annotated[datetime, msgspec.Meta(tz=True)]
    clock_offset_s: float | None
    verified: Count
    failed: Count


def default_devices_folder() -> Path:
    """`retrograph` in the user's folder of settings; LibraryError where the user has no home."""
    try:
        return platformdirs.user_config_path("retrograph", appauthor=False)
    except RuntimeError as error:
        raise LibraryError("this user has no home folder for settings: set HOME or XDG_CONFIG_HOME") from error


class PairedDevices:
    """The devices in one folder, which is made when something is stored."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def all(self) -> list[PairedDevice]:
        """Every paired device, sorted by id.

        Raises
        ------
        RecordError
            A file is damaged; names it.
        """
        files = sorted((self.folder / "devices").glob("*.json"))
        return [decode_record(read_small(path, _REMEDY), PairedDevice, path, _REMEDY) for path in files]

    def find(self, name: str) -> PairedDevice:
        """The device of that id or host name, or the only one whose id begins or ends so.

        Raises
        ------
        NoSource
            None or several match.
        """
        devices = self.all()
        exact = [device for device in devices if name in (device.device_id, device.host)]
        some = [one for one in devices if name and (one.device_id.startswith(name) or one.device_id.endswith(name))]
        found = exact or some
        if len(found) != 1:
            known = ", ".join(device.device_id for device in devices) or "none yet, run `retrosync pair`"
            many = len(found) or "none"
            raise NoSource(f"{name!r}: is no folder and matches {many} of the paired devices: {known}")
        return found[0]

    def save(self, device: PairedDevice) -> None:
        """Store a device, replacing its earlier record."""
        self._store("devices", device.device_id, device)

    def forget(self, device_id: str) -> None:
        """Remove a device's records."""
        with self._translating():
            for kind in ("devices", "synced"):
                (self.folder / kind / f"{device_id}.json").unlink(missing_ok=True)

    def sync_state(self, device_id: str) -> SyncState | None:
        """Outcome of the last sync, None before the first."""
        path = self.folder / "synced" / f"{device_id}.json"
        return decode_record(read_small(path, _REMEDY), SyncState, path, _REMEDY) if path.exists() else None

    def save_sync_state(self, state: SyncState) -> None:
        """Store the outcome of a sync."""
        self._store("synced", state.device_id, state)

    def private_key(self, make: Callable[[], bytes]) -> Path:
        """File of this workstation's private key; `make` generates it when absent."""
        path = self.folder / "id_ed25519"
        if not path.exists():
            with self._translating():
                self.folder.mkdir(parents=True, exist_ok=True, mode=0o700)
                replace_file(path, make(), SECRET)
        # Windows keeps rights elsewhere: a user's folder is that user's.
        if os.name == "posix" and path.stat().st_mode & 0o077:
            raise HostError(f"{path}: other users may read this secret: chmod 600 it, or remove it and pair again")
        return path

    def _store(self, kind: str, device_id: str, record: Record) -> None:
        with self._translating():
            self.folder.mkdir(parents=True, exist_ok=True, mode=0o700)
            (self.folder / kind).mkdir(exist_ok=True, mode=0o700)
            replace_file(self.folder / kind / f"{device_id}.json", encode_record(record), SECRET)

    @contextmanager
    def _translating(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise HostError(f"{self.folder}: the settings cannot be stored {explain_os_error(error)}") from error


def this_host() -> str:
    """This workstation's name, for people."""
    return platform.node()[:64] or "workstation"
