"""A library that others fill: whatever is new is reconstructed and measured.

What is done is known by the files that are there, so that a program that was stopped goes on where it was: a scan with
results of this version is not reconstructed again, and one whose measurement states its newest results and this recipe
is not measured again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Final

import msgspec

from device.bundles.bundle import bundle_ids
from device.bundles.record import sha256_bytes
from device.bundles.scan import ScanBundle
from device.errors import DeviceError
from device.io.atomic import write_output
from device.io.lock import FolderLocked, locked_directory
from device.io.system import explain_os_error
from host_sync.batch.library_batch import ReconstructionOptions, ScanOutcome, reconstruct_all
from host_sync.errors import HostError, LibraryError
from host_sync.library.library import Library
from host_sync.results.files import RECORD_FILE

if TYPE_CHECKING:
    from host_sync.measurement.recipe import Recipe
    from host_sync.reconstruction.scans import LibraryReconstructor

MEASUREMENTS: Final = "measurements"
"""Folder of a library with one JSON file for each scan that was measured."""

MEASURED: Final = "measured"
"""Key in such a file for what was measured."""

_Stamp = tuple[str, int] | None
"""Name of a scan's newest results and when their record was written, ns; None without results."""


class _Measured(msgspec.Struct, frozen=True):
    """Inputs of a measurement.

    result : name of the folder of results
    result_sha256 : of their record
    recipe_sha256 : of the recipe, as compact JSON with all its keys
    """

    result: str
    result_sha256: str
    recipe_sha256: str


class _File(msgspec.Struct, frozen=True):
    """Fields of a measurement's file that are read."""

    measured: _Measured | None = None


@contextmanager
def only_watch(library: Library) -> Iterator[None]:
    """Enter a context in which no other watch works on a library.

    Raises
    ------
    LibraryError
        Another one does, or the library cannot be written.
    """
    place = library.root / MEASUREMENTS
    with ExitStack() as stack:
        with library.translating("written"):
            place.mkdir(exist_ok=True)
            try:
                stack.enter_context(locked_directory(place, wait=False))
            except FolderLocked as error:
                raise LibraryError(
                    f"{library.root}: another watch works on this library: end that first ({error.strerror})"
                ) from error
        yield


class LibraryWatch:
    """The scans of a library that are new, and what is done with them.

    A scan that failed is tried again when another calibration has come, or in the next run.

    Parameters
    ----------
    library : that others fill
    job : makes the calibrations, and reconstructs where one process is enough
    recipe : of the measurement
    workers : as for `reconstruct_all`
    report_progress : is given a few words as each step begins
    """

    def __init__(
        self,
        library: Library,
        job: LibraryReconstructor,
        recipe: Recipe,
        workers: int | None = None,
        report_progress: Callable[[str], None] = lambda _: None,
    ) -> None:
        self._library = library
        self._job = job
        self._recipe = recipe
        self._workers = workers
        self._report_progress = report_progress
        self._done: dict[str, _Stamp] = {}
        self._failed: dict[str, tuple[frozenset[str], _Stamp]] = {}

    def look(self) -> Iterator[ScanOutcome]:
        """Yield the outcome of every scan that is new now.

        The folder of an outcome is that of the results, which were measured.

        Raises
        ------
        LibraryError
            The library is missing or cannot be read.
        OutputError
            A measurement cannot be written.
        """
        self._library.require()
        with self._library.translating("read"):
            scans = bundle_ids(self._library.root, "scans")
            calibrations = frozenset(bundle_ids(self._library.root, "calibrations"))
        new = []
        for name in scans:
            stamp = _stamp(self._results(name))
            is_done = name in self._done and self._done[name] == stamp
            if not is_done and self._failed.get(name) != (calibrations, stamp):
                new.append(name)
        for outcome in self._outcomes(new):
            stamp = _stamp(outcome.folder)
            outcome = outcome if outcome.folder is None else self._measured(outcome, outcome.folder)
            if outcome.reason is None:
                self._done[outcome.scan] = stamp
            else:
                self._failed[outcome.scan] = (calibrations, stamp)
            yield outcome

    def _outcomes(self, names: list[str]) -> Iterator[ScanOutcome]:
        """Yield results of these scans: those that an earlier run left without a measurement, then new ones."""
        new: list[ScanBundle] = []
        for name in names:
            results = self._results(name)
            if results is not None and self._is_measured(name, results):
                self._done[name] = _stamp(results)
            elif results is not None:
                yield ScanOutcome(name, results)
            else:
                try:
                    new.append(self._library.find(name))
                except (DeviceError, HostError) as error:
                    yield ScanOutcome(name, reason=str(error))
        if new:
            yield from reconstruct_all(new, ReconstructionOptions(self._library.root), self._job, self._workers)

    def _results(self, name: str) -> Path | None:
        """Return the newest results of this version that a scan has; None where it has none."""
        return self._library.newest_result_of(self._library.root / "scans" / name, version("retrograph"))

    def _place(self, name: str) -> Path:
        return self._library.root / MEASUREMENTS / f"{name}.json"

    def _is_measured(self, name: str, results: Path) -> bool:
        """Return whether the measurement of a scan was made of these results by this recipe."""
        try:
            held = msgspec.json.decode(self._place(name).read_bytes(), type=_File)
            return held.measured == self._what(results)
        except (OSError, msgspec.DecodeError, UnicodeDecodeError, RecursionError):
            return False

    def _what(self, results: Path) -> _Measured:
        record = (results / RECORD_FILE).read_bytes()
        return _Measured(results.name, sha256_bytes(record), sha256_bytes(msgspec.json.encode(self._recipe)))

    def _measured(self, outcome: ScanOutcome, folder: Path) -> ScanOutcome:
        """Write the measurement of a scan's results; the outcome says why if that is not possible."""
        from host_sync.measurement.measure import measure_result
        from host_sync.measurement.measurement import as_record

        self._report_progress(f"{outcome.scan[-10:]}: measuring")
        try:
            what = self._what(folder)
            record = as_record(measure_result(folder, self._recipe, self._report_progress)) | {MEASURED: what}
        except (DeviceError, HostError) as error:
            return ScanOutcome(outcome.scan, reason=str(error))
        except OSError as error:
            return ScanOutcome(outcome.scan, reason=f"{folder} cannot be read {explain_os_error(error)}")
        place = self._place(outcome.scan)
        with self._library.translating("written"):
            place.parent.mkdir(exist_ok=True)
        write_output(place, msgspec.json.format(msgspec.json.encode(record), indent=2))
        return outcome


def _stamp(results: Path | None) -> _Stamp:
    """Return changes when the results do; a record that cannot be read now is written at zero."""
    if results is None:
        return None
    try:
        return results.name, (results / RECORD_FILE).stat().st_mtime_ns
    except OSError:
        return results.name, 0
