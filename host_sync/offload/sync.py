"""Several devices side by side into one library; one that fails does not hold up the others."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager
from datetime import UTC, datetime

from device.errors import DeviceError
from host_sync.errors import HostError
from host_sync.library import Library
from host_sync.offload.ledger import PullReport
from host_sync.offload.paired_devices import PairedDevice, PairedDevices, SyncState, this_host
from host_sync.offload.pull import PullProgress, pull_into
from host_sync.offload.receipting import Vouch
from host_sync.offload.source import Source

Opener = Callable[[PairedDevice], AbstractContextManager[Source]]
Tell = Callable[[PairedDevice, PullProgress], None]


def utc_now() -> datetime:
    """The time, UTC, in whole seconds."""
    return datetime.now(UTC).replace(microsecond=0)


def sync(
    wanted: Sequence[PairedDevice],
    library: Library,
    devices: PairedDevices,
    open_device: Opener,
    tell: Tell,
    *,
    verify: bool = False,
) -> list[PullReport | HostError | DeviceError]:
    """What became of each device, in the order in which they were given.

    verify : hash again what an earlier pull has left a receipt of

    Raises
    ------
    LibraryError
        The library cannot be written, or is being filled by another program.
    """

    def one(device: PairedDevice) -> PullReport | HostError | DeviceError:
        try:
            return sync_one(device, library, devices, open_device, lambda state: tell(device, state), verify=verify)
        except (HostError, DeviceError) as error:
            return error

    with library.writing(), ThreadPoolExecutor(max_workers=max(1, len(wanted))) as threads:
        return list(threads.map(one, wanted))


def sync_one(
    device: PairedDevice,
    library: Library,
    devices: PairedDevices,
    open_device: Opener,
    tell: Callable[[PullProgress], None],
    *,
    verify: bool = False,
) -> PullReport:
    """Pull from one device into a library that the caller holds, and note how it went and what its clock says."""
    with open_device(device) as source:
        report = pull_into(library, source, tell, Vouch(this_host(), utc_now), verify=verify)
        offset_s = None if report.lost else source.clock_offset_s()
    devices.save_sync_state(
        SyncState(
            device_id=device.device_id,
            synced=utc_now(),
            clock_offset_s=offset_s,
            verified=report.here,
            failed=len(report.failed),
        )
    )
    return report
