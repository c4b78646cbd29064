"""The library: pulled bundles in plain folders that survive without the program.

<root>/scans/<id>/  <root>/calibrations/<id>/  <root>/scans/<id>/results/<version>-<calibration>/
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Final, TypeVar

from device.bundle_layout import MANIFESTS, BundleKind, Listing, bundle_ids, list_bundles, partial_name
from device.bundle_publishing import locked_directory
from device.calibration_bundle import CalibrationBundle, read_calibration
from device.disk_advice import explain_refusal
from device.durable import discard, publish_directory
from device.errors import DeviceError, RecordError
from device.scan_bundle import ScanBundle, read_scan
from host_sync.errors import (
    BusyBundle,
    HostError,
    LibraryError,
    MissingCalibration,
    MissingResult,
    NoSuchBundle,
    SourceLost,
)

RESULTS: Final = "results"
_RESULT_NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9._+-]*")

BundleT = TypeVar("BundleT")

_READERS: Final[dict[BundleKind, Callable[[Path], ScanBundle | CalibrationBundle]]] = {
    "scans": read_scan,
    "calibrations": read_calibration,
}


def default_library() -> Path:
    """Where the library lies when nobody says otherwise."""
    return Path.home() / "Retrograph"


class Library:
    """Scans and calibrations under one folder; nothing is touched until a method is called.

    Every method raises `LibraryError` when the folder cannot be read or written.
    """

    def __init__(self, root: Path) -> None:
        self.root = root

    def scans(self) -> Listing[ScanBundle]:
        """Every scan, in order of ids, and the damaged ones by name."""
        return self._listing("scans", read_scan)

    def calibrations(self) -> Listing[CalibrationBundle]:
        """Every calibration, in order of ids, and the damaged ones by name."""
        return self._listing("calibrations", read_calibration)

    def find(self, name: str) -> ScanBundle:
        """The scan of that id, or the only one whose id begins or ends so.

        Raises
        ------
        NoSuchBundle
            None or several answer to it.
        RecordError
            It is damaged.
        """
        return read_scan(self._find("scans", name))

    def find_calibration(self, name: str) -> CalibrationBundle:
        """The calibration of that id, or the only one whose id begins or ends so; errors as for `find`."""
        return read_calibration(self._find("calibrations", name))

    def calibration_for(self, scan: ScanBundle) -> CalibrationBundle:
        """The calibration that was in force when the scan was taken.

        Raises
        ------
        MissingCalibration
            The scan names none, or the library does not hold it.
        RecordError
            It is damaged.
        """
        calibration_id = scan.record.calibration_id
        if calibration_id is None:
            raise MissingCalibration(f"scan {scan.scan_id} was taken without a calibration: name one to use")
        directory = self.root / "calibrations" / calibration_id
        if not directory.is_dir():
            raise MissingCalibration(
                f"scan {scan.scan_id} needs calibration {calibration_id}, which is not in {self.root}: "
                "pull it from the device that took the scan"
            )
        return read_calibration(directory)

    def result_folder(self, bundle: ScanBundle | CalibrationBundle, version: str, calibration_id: str) -> Path:
        """Where the results of one program version and one calibration belong; not made here."""
        name = f"{version}-{calibration_id}"
        if not _RESULT_NAME.fullmatch(name):
            raise LibraryError(f"{name!r} cannot name a folder of results: use letters, digits and . _ + -")
        return bundle.directory / RESULTS / name

    def results(self, scan: ScanBundle) -> tuple[Path, ...]:
        """Folders of the results that a scan has, sorted."""
        with self.translating("read"):
            folder = scan.directory / RESULTS
            entries = folder.iterdir() if folder.is_dir() else ()
            return tuple(sorted(entry for entry in entries if entry.is_dir() and not entry.name.startswith(".")))

    def newest_result(self, scan: ScanBundle) -> Path:
        """The folder of the results that were written last.

        Raises
        ------
        MissingResult
            The scan has none.
        """
        with self.translating("read"):
            folders = sorted(self.results(scan), key=lambda folder: folder.stat().st_mtime_ns)
        if not folders:
            raise MissingResult(
                f"{scan.scan_id}: has no results: run retrosync reconstruct --library {self.root} {scan.scan_id}"
            )
        return folders[-1]

    def require(self) -> None:
        """Refuse a library that is not there."""
        if not self.root.is_dir():
            raise LibraryError(f"{self.root}: there is no library: pull into it first, or name another")

    def free_bytes(self) -> int:
        """Free space of the library's disk, bytes."""
        with self.translating("read"):
            return shutil.disk_usage(self.root).free

    def looks_whole(self, kind: BundleKind, bundle_id: str) -> bool:
        """Whether it holds a bundle whose manifest is proven and whose files have their sizes; none is hashed."""
        directory = self.root / kind / bundle_id
        try:
            files = _READERS[kind](directory).record.files
            return all((directory / name).lstat().st_size == entry.size for name, entry in files.items())
        except (OSError, RecordError):
            return False

    def unfinished_bytes(self, kind: BundleKind, bundle_id: str) -> int:
        """Size of what an earlier transfer of a bundle left."""
        with self.translating("read"):
            return sum(path.lstat().st_size for path in (self.root / kind / partial_name(bundle_id)).glob("*"))

    @contextmanager
    def writing(self) -> Iterator[None]:
        """Makes the folder ready and keeps every other writer out; unfinished bundles stay, to be completed."""
        with ExitStack() as stack:
            with self.translating("written"):
                for kind in MANIFESTS:
                    (self.root / kind).mkdir(parents=True, exist_ok=True)
                self._lock_out_others(stack)
            yield

    @contextmanager
    def publishing(self, kind: BundleKind, bundle_id: str, synced: Collection[str] = ()) -> Iterator[Path]:
        """Directory for a bundle's files, published when the block ends well.

        synced : names of files that will be on the disk by then

        When the source went away or somebody stopped the program, it stays as it is and the next one goes on in it;
        after any other error it is removed.

        Raises
        ------
        LibraryError
            The same bundle is coming from another source right now, or the disk refused.
        """
        partial = self.root / kind / partial_name(bundle_id)
        with ExitStack() as stack:
            with self.translating("written"):
                partial.mkdir(exist_ok=True)
                self._lock_bundle(stack, partial)
            try:
                with self.translating("written"):
                    yield partial
                    publish_directory(partial, self.root / kind / bundle_id, synced)
            except BaseException as error:
                if not isinstance(error, (SourceLost, KeyboardInterrupt)):
                    discard(partial)
                raise

    def _lock_bundle(self, stack: ExitStack, partial: Path) -> None:
        try:
            stack.enter_context(locked_directory(partial, wait=False))
        except BlockingIOError as error:
            raise BusyBundle(f"{partial}: is coming from another source right now: repeat when that is done") from error

    def _lock_out_others(self, stack: ExitStack) -> None:
        try:
            stack.enter_context(locked_directory(self.root, wait=False))
        except BlockingIOError as error:
            raise LibraryError(
                f"{self.root}: another program is filling this library: wait until it is done"
            ) from error

    def _listing(self, kind: BundleKind, read: Callable[[Path], BundleT]) -> Listing[BundleT]:
        self.require()
        with self.translating("read"):
            return list_bundles(self.root, kind, read)

    def _find(self, kind: BundleKind, name: str) -> Path:
        with self.translating("read"):
            ids = bundle_ids(self.root, kind)
        what = kind.removesuffix("s")
        if name in ids:
            return self.root / kind / name
        matches = [one for one in ids if name and (one.startswith(name) or one.endswith(name))]
        if not matches:
            raise NoSuchBundle(f"{self.root}: holds no {what} {name!r}: pull it, or give an id of {self.root / kind}")
        if len(matches) > 1:
            some = ", ".join(matches[:5]) + (", …" if len(matches) > 5 else "")
            raise NoSuchBundle(f"{self.root}: {name!r} is the id of {len(matches)} {kind}, give more of it: {some}")
        return self.root / kind / matches[0]

    @contextmanager
    def translating(self, verb: str) -> Iterator[None]:
        """Turns the system's errors into one sentence."""
        try:
            yield
        except (HostError, DeviceError):
            raise
        except OSError as error:
            raise LibraryError(f"{self.root}: the library cannot be {verb} {explain_refusal(error)}") from error
