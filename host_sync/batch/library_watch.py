"""A library that others fill: whatever is new is reconstructed and measured.

What is done is known by the files that are there, so that a program that was stopped goes on where it was: a scan with
results of this version is not reconstructed again, and one with a measurement is not measured again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Final

import msgspec

from device.bundles.layout import bundle_ids
from device.bundles.scan import ScanBundle
from device.errors import DeviceError
from device.io.atomic import RESULTS, write_output
from host_sync.batch.library_batch import ScanWork, reconstruct_all
from host_sync.batch.scan_outcome import ScanOutcome
from host_sync.errors import HostError
from host_sync.library.library import Library

if TYPE_CHECKING:
    from host_sync.measurement.recipe import Recipe
    from host_sync.reconstruction.from_library import LibraryReconstructor

MEASUREMENTS: Final = "measurements"
"""Folder of a library with one JSON file for each scan that was measured."""


class LibraryWatch:
    """The scans of a library that are new, and what is done with them.

    A scan that failed is tried again when another calibration has come, or in the next run.

    Parameters
    ----------
    library : that others fill
    job : makes the calibrations, and reconstructs where one process is enough
    recipe : of the measurement
    workers : as for `reconstruct_all`
    tell : is given a few words as each step begins
    """

    def __init__(
        self,
        library: Library,
        job: LibraryReconstructor,
        recipe: Recipe,
        workers: int | None = None,
        tell: Callable[[str], None] = lambda _: None,
    ) -> None:
        self._library = library
        self._job = job
        self._recipe = recipe
        self._workers = workers
        self._tell = tell
        self._done: set[str] = set()
        self._failed: dict[str, frozenset[str]] = {}

    def look(self) -> Iterator[ScanOutcome]:
        """What becomes of every scan that is new now; a folder among them is that of the results, which were measured.

        Raises
        ------
        LibraryError
            The library is missing or cannot be read.
        OutputError
            A measurement cannot be written.
        """
        self._library.require()
        with self._library.translating("read"):
            names = [name for name in bundle_ids(self._library.root, "scans") if name not in self._done]
            calibrations = frozenset(bundle_ids(self._library.root, "calibrations"))
        names = [name for name in names if self._failed.get(name) != calibrations]
        for outcome in self._outcomes(names):
            outcome = outcome if outcome.folder is None else self._measured(outcome, outcome.folder)
            if outcome.reason is None:
                self._done.add(outcome.scan)
            else:
                self._failed[outcome.scan] = calibrations
            yield outcome

    def _outcomes(self, names: list[str]) -> Iterator[ScanOutcome]:
        """Results of these scans: those that an earlier run left without a measurement, then new ones."""
        new: list[ScanBundle] = []
        for name in names:
            measured, results = self._place(name).is_file(), self._results(name)
            if results is not None and measured:
                self._done.add(name)
            elif results is not None:
                yield ScanOutcome(name, results)
            else:
                try:
                    new.append(self._library.find(name))
                except (DeviceError, HostError) as error:
                    yield ScanOutcome(name, reason=str(error))
        if new:
            yield from reconstruct_all(new, ScanWork(self._library.root), self._job, self._workers)

    def _results(self, name: str) -> Path | None:
        """The results of this version that a scan has, the last by name; None where it has none."""
        folder = self._library.root / "scans" / name / RESULTS
        return max(folder.glob(f"{version('retrograph')}-*"), default=None)

    def _place(self, name: str) -> Path:
        return self._library.root / MEASUREMENTS / f"{name}.json"

    def _measured(self, outcome: ScanOutcome, folder: Path) -> ScanOutcome:
        """Write the measurement of a scan's results; the outcome says why if that is not possible."""
        from host_sync.measurement.measure import measure_result
        from host_sync.measurement.measurement_text import as_record

        self._tell(f"{outcome.scan[-10:]}: measuring")
        try:
            record = as_record(measure_result(folder, self._recipe, self._tell))
        except (DeviceError, HostError) as error:
            return ScanOutcome(outcome.scan, reason=str(error))
        place = self._place(outcome.scan)
        with self._library.translating("written"):
            place.parent.mkdir(exist_ok=True)
        write_output(place, msgspec.json.format(msgspec.json.encode(record), indent=2))
        return outcome
