"""Deleting scans, with undo until the instrument is switched off."""

from __future__ import annotations

from threading import Lock

from device.errors import RecordError
from device.instrument.state import StateStore
from device.store.deletion import delete_scan, purge_deleted, restore_scan
from device.store.store import BundleStore


class DeletedScans:
    """The scans that were deleted since the start; for any thread. What an earlier start deleted is removed at once."""

    def __init__(self, states: StateStore, store: BundleStore) -> None:
        self._states = states
        self._store = store
        self._lock = Lock()
        self._ids: list[str] = []
        purge_deleted(store.root)

    def delete(self, scan_id: str) -> None:
        """Delete a scan. Errors as for `delete_scan`."""
        with self._lock:
            delete_scan(self._store.root, scan_id)
            self._ids.append(scan_id)
        self._states.count_stored(-1)

    def undo(self) -> str:
        """Bring the scan that was deleted last back; returns its id.

        Raises
        ------
        RecordError
            None was deleted since the start, or its room was needed.
        StoreError
            The disk refused; the same scan can be tried again.
        """
        with self._lock:
            if not self._ids:
                raise RecordError("no scan was deleted since the instrument was switched on")
            scan_id = self._ids[-1]
            try:
                restore_scan(self._store.root, scan_id)
            except RecordError:
                self._ids.pop()
                raise
            self._ids.pop()
        self._states.count_stored(1)
        return scan_id

    def purge(self) -> None:
        """Remove them for good, at power-off."""
        with self._lock:
            self._ids.clear()
            purge_deleted(self._store.root)
