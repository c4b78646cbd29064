"""The library: pulled bundles in plain folders that are readable without the program.

<root>/scans/<id>/  <root>/calibrations/<id>/  <root>/scans/<id>/results/<version>-<calibration>/
<root>/intake.jsonl  <root>/set-aside/  <root>/index.sqlite3  <root>/measurements/<id>.json
"""

from __future__ import annotations

import os
import re
import shutil
import threading
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Final, TypeAlias, TypeVar

from device.bundles.bundle import MANIFESTS, BundleKind, Listing, bundle_ids, list_bundles, partial_name
from device.bundles.calibration import CalibrationBundle, CalibrationRecord, decode_calibration, read_calibration
from device.bundles.record import read_manifest, sha256_bytes
from device.bundles.scan import ScanBundle, ScanRecord, decode_scan, read_scan
from device.errors import DeviceError, RecordError
from device.io.atomic import RESULTS, publish_directory, remove_tree_quietly
from device.io.lock import locked_directory
from device.io.system import explain_os_error, make_files_read_only
from host_sync.errors import (
    BusyBundle,
    HostError,
    LibraryError,
    MissingCalibration,
    MissingResult,
    NoSuchBundle,
    SourceLost,
)
from host_sync.library.intake import (
    SET_ASIDE,
    Event,
    IntakeHistory,
    append_intake,
    move_aside,
    read_intake,
    record_refusal,
    retire_intake,
    write_head,
)
from host_sync.library.labels import read_labels

_RESULT_NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9._+-]*")

AnyBundle: TypeAlias = ScanBundle | CalibrationBundle
BundleT = TypeVar("BundleT")

DECODERS: Final[dict[BundleKind, Callable[[bytes, str | Path], ScanRecord | CalibrationRecord]]] = {
    "scans": decode_scan,
    "calibrations": decode_calibration,
}


def default_library() -> Path:
    """Return the library's folder unless another is named; LibraryError where the user has no home."""
    try:
        return Path.home() / "Retrograph"
    except RuntimeError as error:
        raise LibraryError("this user has no home folder: name the library with --library") from error


class Library:
    """Scans and calibrations under one folder; nothing is touched until a method is called.

    Every method raises `LibraryError` when the folder cannot be read or written.
    """

    def __init__(self, root: Path) -> None:
        self.root = root
        self._intake_lock = threading.Lock()
        self._history: IntakeHistory | None = None

    def scans(self) -> Listing[ScanBundle]:
        """Return every scan, sorted by id, and the damaged ones."""
        return self._listing("scans", read_scan)

    def calibrations(self) -> Listing[CalibrationBundle]:
        """Return every calibration, sorted by id, and the damaged ones."""
        return self._listing("calibrations", read_calibration)

    def bundles(self) -> Listing[AnyBundle]:
        """Return every calibration, then every scan."""
        calibrations, scans = self.calibrations(), self.scans()
        return Listing((*calibrations.bundles, *scans.bundles), (*calibrations.damaged, *scans.damaged))

    def find(self, name: str) -> ScanBundle:
        """Return the scan of that id, or the only one whose id begins or ends so.

        Raises
        ------
        NoSuchBundle
            None or several match.
        RecordError
            It is damaged.
        """
        return read_scan(self._find("scans", name))

    def named(self, name: str) -> ScanBundle:
        """Return the scan that `find` finds, or the only one whose label or part has that name.

        A label goes before a part.

        Raises
        ------
        NoSuchBundle
            None or several match.
        RecordError
            It is damaged.
        LibraryError
            The labels are damaged.
        """
        try:
            return self.find(name)
        except NoSuchBundle as error:
            labelled = {scan for scan, label in read_labels(self.root).scans.items() if label.name == name}
            scans = self.scans().bundles
            for what, found in (
                ("have the name", [scan for scan in scans if scan.scan_id in labelled]),
                ("are of the part", [scan for scan in scans if scan.record.annotations.part == name]),
            ):
                if len(found) == 1:
                    return found[0]
                if found:
                    names = ", ".join(scan.scan_id for scan in found)
                    raise NoSuchBundle(f"{len(found)} scans {what} {name}: name one of {names}") from error
            raise

    def find_calibration(self, name: str) -> CalibrationBundle:
        """Return the calibration of that id, or the only one whose id begins or ends so; errors as for `find`."""
        return read_calibration(self._find("calibrations", name))

    def calibration_for(self, scan: ScanBundle) -> CalibrationBundle:
        """Return the calibration that was active when the scan was taken.

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

    def result_folder(self, bundle: AnyBundle, version: str, calibration_id: str) -> Path:
        """Return the folder for the results of one program version and one calibration; not made here."""
        name = f"{version}-{calibration_id}"
        if not _RESULT_NAME.fullmatch(name):
            raise LibraryError(f"{name!r} cannot name a folder of results: use only letters, digits and . _ + -")
        return bundle.directory / RESULTS / name

    def results(self, scan: ScanBundle) -> tuple[Path, ...]:
        """Return folders of a scan's results, sorted."""
        with self.translating("read"):
            return tuple(_result_folders(scan.directory))

    def newest_result(self, scan: ScanBundle) -> Path:
        """Return the folder of the results written last.

        Raises
        ------
        MissingResult
            The scan has none.
        """
        found = self.newest_result_of(scan.directory)
        if found is None:
            raise MissingResult(
                f"{scan.scan_id}: has no results: run retrosync reconstruct --library {self.root} {scan.scan_id}"
            )
        return found

    def newest_result_of(self, directory: Path, version: str | None = None) -> Path | None:
        """Return the folder of the results written last in a scan's folder; None without any.

        version : of the program that wrote them; any by default
        """
        with self.translating("read"):
            folders = _result_folders(directory)
            if version is not None:
                folders = [folder for folder in folders if folder.name.startswith(f"{version}-")]
            return max(folders, key=lambda folder: folder.stat().st_mtime_ns, default=None)

    def require(self) -> None:
        """Refuse a library that does not exist."""
        if not self.root.is_dir():
            raise LibraryError(f"{self.root}: there is no library: pull into it first, or name another")

    def free_bytes(self) -> int:
        """Free space of the library's disk, bytes."""
        with self.translating("read"):
            return shutil.disk_usage(self.root).free

    def looks_whole(self, kind: BundleKind, bundle_id: str) -> bool:
        """Return whether a bundle matches its intake record by manifest and file sizes; no file is hashed."""
        directory = self.root / kind / bundle_id
        entry = self.intake().held.get((kind, bundle_id))
        try:
            manifest = read_manifest(directory, MANIFESTS[kind])
            files = DECODERS[kind](manifest, directory).files
            sizes = all((directory / name).lstat().st_size == file.size for name, file in files.items())
            return entry is not None and entry.manifest_sha256 == sha256_bytes(manifest) and sizes
        except (OSError, RecordError):
            return False

    def unfinished_bytes(self, kind: BundleKind, bundle_id: str) -> int:
        """Return bytes left by an earlier transfer of a bundle."""
        with self.translating("read"):
            return sum(path.lstat().st_size for path in (self.root / kind / partial_name(bundle_id)).glob("*"))

    def intake(self) -> IntakeHistory:
        """Return what the library has taken in so far, by its intake record."""
        with self._intake_lock, self.translating("read"):
            if self._history is None:
                self._history = read_intake(self.root)
            return self._history

    def record(self, event: Event, kind: BundleKind, bundle_id: str, manifest: bytes, source: str) -> None:
        """Append an event to the intake record, durably; the caller holds the library for writing.

        A record that cannot be trusted is not continued: a bundle is then only stored.
        """
        self._append(event, kind, bundle_id, sha256_bytes(manifest), source)

    def refuse(self, kind: BundleKind, name: str, reason: str, source: str) -> None:
        """Note under `set-aside` why a bundle was not taken in, if the library can be written."""
        with suppress(OSError):
            record_refusal(self.root, kind, name, reason, source)

    def move_aside(self, kind: BundleKind, bundle_id: str, reason: str) -> Path:
        """Move a damaged bundle to `set-aside` and record that; returns where it is now."""
        entry = self.intake().held.get((kind, bundle_id))
        with self.translating("written"):
            target = move_aside(self.root, kind, bundle_id, reason)
        if entry is not None:
            self._append("set-aside", kind, bundle_id, entry.manifest_sha256, str(self.root))
        return target

    def restart_record(self) -> None:
        """Move a damaged intake record to `set-aside` and start a new one; the caller holds the library for writing."""
        with self._intake_lock, self.translating("written"):
            retire_intake(self.root, self.root / SET_ASIDE / "intake")
            self._history = None

    def forget(self, name: str) -> None:
        """Record that the user removed a bundle, by its whole id; the caller holds the library for writing.

        Raises
        ------
        NoSuchBundle
            The intake record expects no bundle of that id, or the library still has it.
        """
        held = self.intake().held
        key = next((key for key in held if key[1] == name), None)
        if key is None:
            raise NoSuchBundle(f"{self.root}: its intake record expects no bundle {name!r}: give its complete id")
        if (self.root / key[0] / name).exists():
            raise NoSuchBundle(f"{self.root / key[0] / name}: is still there: remove it first")
        self._append("forgotten", *key, held[key].manifest_sha256, str(self.root))

    def _append(self, event: Event, kind: BundleKind, bundle_id: str, manifest_sha256: str, source: str) -> None:
        history = self.intake()
        if history.fault is None:
            with self._intake_lock, self.translating("written"):
                entry = append_intake(self.root, event, kind, bundle_id, manifest_sha256, source)
                history.last[kind, bundle_id] = entry

    @contextmanager
    def writing(self) -> Iterator[None]:
        """Prepare the folder and keep other writers out; unfinished bundles stay, to be completed."""
        with ExitStack() as stack:
            with self.translating("written"):
                for kind in MANIFESTS:
                    (self.root / kind).mkdir(parents=True, exist_ok=True)
                self._lock(stack, self.root, "another program is filling this library: wait until it is done")
            self._history = None
            try:
                yield
            finally:
                with suppress(RecordError), self.translating("written"):
                    if self.intake().fault is None:
                        write_head(self.root)

    @contextmanager
    def publishing(self, kind: BundleKind, bundle_id: str, synced: Collection[str] = ()) -> Iterator[Path]:
        """Yield a directory for a bundle's files, published read-only when the block ends well.

        synced : names of files that will be on the disk by then

        When the source is lost or the user stops the program, the directory stays and the next transfer continues in
        it; after any other error it is removed.

        Raises
        ------
        LibraryError
            The same bundle is coming from another source, or the disk refused.
        """
        partial = self.root / kind / partial_name(bundle_id)
        with ExitStack() as stack:
            with self.translating("written"):
                if os.path.lexists(partial) and (partial.is_symlink() or not partial.is_dir()):
                    raise BusyBundle(f"{partial}: is a file where a folder is needed: remove it and repeat")
                partial.mkdir(exist_ok=True)
                try:
                    stack.enter_context(locked_directory(partial, wait=False))
                except BlockingIOError as error:
                    raise BusyBundle(
                        f"{partial}: is coming from another source right now: repeat when that is done"
                    ) from error
            try:
                with self.translating("written"):
                    yield partial
                    make_files_read_only(partial)
                    publish_directory(partial, self.root / kind / bundle_id, synced)
            except BaseException as error:
                if not isinstance(error, (SourceLost, KeyboardInterrupt)):
                    remove_tree_quietly(partial)
                raise

    def _lock(self, stack: ExitStack, folder: Path, taken: str) -> None:
        try:
            stack.enter_context(locked_directory(folder, wait=False))
        except BlockingIOError as error:
            raise LibraryError(f"{folder}: {taken} ({error.strerror})") from error

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
        """Turn the system's errors into one sentence that names the library."""
        try:
            yield
        except (HostError, DeviceError):
            raise
        except OSError as error:
            raise LibraryError(f"{self.root}: the library cannot be {verb} {explain_os_error(error)}") from error


def _result_folders(directory: Path) -> list[Path]:
    """Return folders of results in a scan's folder, sorted."""
    folder = directory / RESULTS
    entries = folder.iterdir() if folder.is_dir() else ()
    return sorted(entry for entry in entries if entry.is_dir() and not entry.name.startswith("."))
