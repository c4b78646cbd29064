"""Height maps of entries; the last few stay in memory, because a page requests one in bands."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from threading import Lock
from typing import Final

import numpy as np

from device.surface.fields import Float32Array
from host_sync.errors import ViewError
from host_sync.results.field_file import read_field, read_samples, read_stack_page
from host_sync.results.files import HEIGHT_SIGMA_FILE, SAMPLES_FILE
from host_sync.results.reader import max_sample_values
from host_sync.viewer.entry import Entry

KEPT: Final = 3

MAX_HEIGHT_UM: Final = 1e6
"""Heights beyond this come from a damaged file; squared slopes would overflow."""


class Heights:
    """Reads height maps and the fields beside them, and keeps the last `KEPT`."""

    def __init__(self) -> None:
        self._held: OrderedDict[tuple[str, int | str], Float32Array] = OrderedDict()
        self._lock = Lock()

    def read(self, entry: Entry, page: int = 0) -> Float32Array:
        """The height map: float32 array of shape (H, W), µm, NaN where invalid or impossible; read only.

        Raises
        ------
        ViewError
            There is no such page.
        UnreadableResult
            The file is damaged or of another size than its record states.
        """
        if not 0 <= page < entry.pages:
            raise ViewError(f"{entry.title}: has no frame {page}: choose one from 0 to {entry.pages - 1}")
        return self._holding((entry.stamp(), page), lambda: _read(entry, page))

    def sigma(self, entry: Entry) -> Float32Array | None:
        """The standard uncertainty, float32 array of shape (H, W), µm; None when the entry has none.

        Raises
        ------
        UnreadableResult
            It is damaged or not as large as the height map.
        """
        path = entry.folder / HEIGHT_SIGMA_FILE
        if entry.kind not in {"result", "difference"} or not path.is_file():
            return None
        return self._holding((entry.stamp(), path.name), lambda: read_field(path, entry.shape))

    def samples(self, entry: Entry) -> Float32Array | None:
        """Monte Carlo samples of the height error, float32 array of shape (K, h, w), µm; None when there are none.

        Raises
        ------
        UnreadableResult
            They are damaged.
        """
        path = entry.folder / SAMPLES_FILE
        if entry.kind != "result" or not path.is_file():
            return None
        return self._holding((entry.stamp(), path.name), lambda: read_samples(path, max_sample_values(entry.shape)))

    def _holding(self, key: tuple[str, int | str], read: Callable[[], Float32Array]) -> Float32Array:
        with self._lock:
            if key not in self._held:
                self._held[key] = read()
                while len(self._held) > KEPT:
                    self._held.popitem(last=False)
            self._held.move_to_end(key)
            return self._held[key]


def _read(entry: Entry, page: int) -> Float32Array:
    if entry.kind == "video":
        z_um = read_stack_page(entry.heights, page, entry.shape)
    else:
        z_um = read_field(entry.heights, entry.shape)
    np.copyto(z_um, np.nan, where=~(np.abs(z_um) <= MAX_HEIGHT_UM))
    return z_um
