"""Devices that announce themselves on the local network."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from zeroconf import InterfaceChoice, ServiceBrowser, ServiceStateChange, Zeroconf

from host_sync.errors import SourceError

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
