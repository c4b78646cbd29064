"""Job, part, operator and note of the next scans; parts number themselves if that is wanted."""

from __future__ import annotations

import re
from threading import Lock
from typing import Final

from msgspec import structs

from device.bundles.scan import Annotations
from device.errors import DeviceError
from device.instrument.events import Failed
from device.instrument.state import StateStore
from device.store.choices import write_sticky
from device.store.store import BundleStore

_NUMBER: Final = re.compile(r"(\d+)(?!.*\d)")


def next_part(part: str) -> str:
    """Return the next part's name: "A-09" after "A-08", "lid-2" after "lid"; the last number in it counts."""
    found = _NUMBER.search(part)
    if found is None:
        return f"{part}-2"
    number = str(int(found[1]) + 1).zfill(len(found[1]))
    return f"{part[: found.start()]}{number}{part[found.end() :]}"


class ScanLabels:
    """The annotations of the next scans, in the state and on the disk; for any thread."""

    def __init__(self, states: StateStore, store: BundleStore) -> None:
        self._states = states
        self._store = store
        self._lock = Lock()

    def set(self, annotations: Annotations) -> None:
        """Use these for every later scan, also after a restart."""
        with self._lock:
            self._set(annotations)

    def take(self) -> Annotations:
        """Return the annotations of a scan that was taken now; the next part gets the next number."""
        with self._lock:
            taken = self._states.state.sticky
            if self._states.state.settings.number_parts and taken.part:
                self._set(structs.replace(taken, part=next_part(taken.part)))
            return taken

    def give_back(self, annotations: Annotations) -> None:
        """The scan that took them was not stored: the next one gets its number, unless another has one already."""
        with self._lock:
            part = annotations.part
            if part and self._states.state.sticky == structs.replace(annotations, part=next_part(part)):
                self._set(annotations)

    def _set(self, annotations: Annotations) -> None:
        self._states.update(sticky=annotations)
        try:
            write_sticky(self._store.root, annotations)
        except DeviceError as error:
            self._states.publish(Failed(str(error)))
