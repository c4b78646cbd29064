"""Devices on the network, those that are paired, and the own key: small files that only their owner can read.

<folder>/id_ed25519  <folder>/devices/<device id>.json  <folder>/synced/<device id>.json
"""

from __future__ import annotations

import os
import platform
import re
import socket
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Annotated, Final, TypeVar

import asyncssh
import msgspec
import platformdirs
from zeroconf import InterfaceChoice, ServiceBrowser, ServiceStateChange, Zeroconf

from device.bundles.record import BundleId, Count, Record, decode_record, encode_record, read_small
from device.errors import DeviceError, RecordError
from device.io.atomic import replace_file
from device.io.system import explain_os_error
from device.pairing import (
    Accepted,
    Answer,
    Call,
    DeviceCard,
    HostCard,
    Opening,
    PairingChannel,
    SshPublicKey,
    code_of,
    commitment_to,
    draw_number,
    leave_host_card,
    read_device_card,
)
from host_sync.errors import HostError, LibraryError, NoSource, PairingError, SourceError

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
        """Return every paired device, sorted by id.

        Raises
        ------
        RecordError
            A file is damaged; names it.
        """
        files = sorted((self.folder / "devices").glob("*.json"))
        return [decode_record(read_small(path, _REMEDY), PairedDevice, path, _REMEDY) for path in files]

    def find(self, name: str) -> PairedDevice:
        """Return the device of that id or host name, or the only one whose id begins or ends so.

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
        """Return the outcome of the last sync, None before the first."""
        path = self.folder / "synced" / f"{device_id}.json"
        return decode_record(read_small(path, _REMEDY), SyncState, path, _REMEDY) if path.exists() else None

    def save_sync_state(self, state: SyncState) -> None:
        """Store the outcome of a sync."""
        self._store("synced", state.device_id, state)

    def private_key(self, make: Callable[[], bytes]) -> Path:
        """Return the file of this workstation's private key; `make` generates it when absent."""
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


# The workstation's side of pairing: exchange cards, let a person compare the codes, store the device's key.

CONVERSATION_S: Final = 10.0
CONFIRMATION_S: Final = 120.0
"""Time for the person who confirms the code on the device."""


def new_private_key() -> bytes:
    """Return a new private key in OpenSSH's format."""
    return asyncssh.generate_private_key("ssh-ed25519").export_private_key()


def own_card(devices: PairedDevices, name: str) -> HostCard:
    """This workstation's card; its key is generated when absent."""
    path = devices.private_key(new_private_key)
    try:
        key = asyncssh.read_private_key(path)
    except (OSError, asyncssh.KeyImportError) as error:
        raise HostError(f"{path}: holds no private key: remove it and pair every device again") from error
    kind, encoded = key.export_public_key().decode().split()[:2]
    return HostCard(name=re.sub(r"[^A-Za-z0-9._-]", "-", name)[:64] or "workstation", public_key=f"{kind} {encoded}")


def pair_over_network(host: str, port: int, card: HostCard, same_code: Callable[[str], bool]) -> PairedDevice:
    """Pair with the device that listens there.

    same_code : asks the person whether the device shows that code

    Raises
    ------
    SourceError
        Nothing listens there.
    PairingError
        The codes differ, the device did not accept, or something else answered.
    """
    try:
        connection = socket.create_connection((host, port), timeout=CONVERSATION_S)
    except (OSError, UnicodeError) as error:
        raise SourceError(
            f"{host}:{port}: no device waits there for pairing ({error}): open its window and check the address"
        ) from error
    number = draw_number()
    with closing(connection):
        channel = PairingChannel(connection, CONVERSATION_S)
        try:
            channel.send(Call(card=card, commitment=commitment_to(card, number)))
            answer = channel.receive(Answer)
            channel.send(Opening(number=number))
        except RecordError as error:
            raise PairingError(
                f"{host}: was not paired, the device is busy with other callers or did not answer ({error}): repeat"
            ) from error
        if not same_code(code_of(card, answer.card, number, answer.number)):
            raise PairingError(f"{host}: was not paired: if the codes differ, something else answers in its place")
        channel.limit(CONFIRMATION_S)
        try:
            channel.receive(Accepted)
        except RecordError as error:
            raise PairingError(
                f"{host}: was not paired, the code was not confirmed on the device ({error}): repeat"
            ) from error
    return _paired(answer.card, host)


def pair_by_card(memory_card: Path, card: HostCard, host: str | None) -> PairedDevice | None:
    """Return the device whose card is on a memory card; None when it has left none yet. Ours is left there in any case.

    host : the device's address; its id under ".local" when None

    Raises
    ------
    PairingError
        The memory card cannot be read or written.
    """
    try:
        device = read_device_card(memory_card)
        leave_host_card(memory_card, card)
    except DeviceError as error:
        raise PairingError(str(error)) from error
    return None if device is None else _paired(device, host or f"{device.device_id}.local")


def keep(devices: PairedDevices, device: PairedDevice, *, replace: bool) -> None:
    """Store a paired device; a changed key, or another device at a known address, only with `replace`.

    replace : the device was set up again; its old record is forgotten

    Raises
    ------
    PairingError
        Its key or its id has changed and `replace` is False.
    """
    known = devices.all()
    before = next((one for one in known if one.device_id == device.device_id), None)
    if before is not None and before.host_key != device.host_key and not replace:
        raise PairingError(
            f"{device.device_id}: presents another host key than when it was paired: if you set it up again, "
            "pair it with --replace; otherwise something else answers in its place"
        )
    others = [one for one in known if one != before and (one.host, one.port) == (device.host, device.port)]
    if others and not replace:
        raise PairingError(
            f"{device.host}: is {device.device_id} and was {others[0].device_id}: if you set it up again, pair it with "
            "--replace and the old record is forgotten; two devices need two addresses"
        )
    for other in others:
        devices.forget(other.device_id)
    devices.save(device)


def _paired(card: DeviceCard, host: str) -> PairedDevice:
    try:
        asyncssh.import_public_key(card.host_key)
    except asyncssh.KeyImportError as error:
        raise PairingError(f"{host}: its host key cannot be read ({error}): check its sshd") from error
    return PairedDevice(device_id=card.device_id, host=host, port=card.port, user=card.user, host_key=card.host_key)


# Devices that announce themselves on the local network.

SERVICE: Final = "_sftp-ssh._tcp.local."
MARK: Final = b"retrograph"
"""Key in the announcement that distinguishes a device from other SFTP servers."""

_RESOLVE_MS: Final = 2000


@dataclass(frozen=True, slots=True)
class Announcement:
    """An announced device: its name, host name, addresses and port."""

    name: str
    host: str
    addresses: tuple[str, ...]
    port: int


def discover(listen_s: float, interfaces: Sequence[str] | None = None, wanted: str | None = None) -> list[Announcement]:
    """Return the devices announced within that time, sorted by name.

    interfaces : own addresses to listen on; all when None
    wanted : name of a device; listening ends as soon as it is found

    Raises
    ------
    SourceError
        There is no network to listen on.
    """
    found: dict[str, Announcement] = {}
    enough = threading.Event()

    def hear(zeroconf: Zeroconf, service_type: str, name: str, state_change: ServiceStateChange) -> None:
        if state_change is ServiceStateChange.Removed:
            found.pop(name, None)
            return
        info = zeroconf.get_service_info(service_type, name, _RESOLVE_MS)
        if info is None or MARK not in info.properties or info.port is None:
            return
        label = name.removesuffix(f".{service_type}")
        found[name] = Announcement(label, (info.server or "").rstrip("."), tuple(info.parsed_addresses()), info.port)
        if label == wanted:
            enough.set()

    try:
        with Zeroconf(interfaces=InterfaceChoice.All if interfaces is None else list(interfaces)) as network:
            with ServiceBrowser(network, SERVICE, handlers=[hear]):
                enough.wait(listen_s)
            return sorted(found.values(), key=lambda one: one.name)
    except OSError as error:
        raise SourceError(f"no network is available ({error}): connect one, or give the device's address") from error
