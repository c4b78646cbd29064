"""Entries of a library, of a folder of results or of one result, and the filters on them."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from threading import Lock
from typing import Final

from device.bundles.scan import read_scan
from device.errors import DeviceError
from host_sync.errors import UnreadableResult, ViewError
from host_sync.library.index import Hit, Query, search
from host_sync.library.library import Library
from host_sync.results.files import RECORD_FILE
from host_sync.viewer.entry import Entry, key_of, quick_look_entry, result_entry

MAX_DEPTH: Final = 3
"""Levels below the named folder that are searched for results."""

MAX_RESULTS: Final = 5000
MAX_DERIVED: Final = 16


@dataclass(frozen=True, slots=True)
class ListFilter:
    """The filters of the page.

    words : each must occur in the facts of a scan
    """

    query: Query = field(default_factory=Query)
    words: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Listing:
    """The entries that match, and one sentence for each scan or result that cannot be shown."""

    entries: tuple[Entry, ...]
    complaints: tuple[str, ...]


class Catalogue:
    """Lists entries and finds them by key; the folders are read each time.

    Parameters
    ----------
    root : a library, the folder of a demo with a library in it, a folder with results in it, or one result

    Raises
    ------
    ViewError, UnreadableResult
        It is none of these, or the one result is damaged.
    """

    def __init__(self, root: Path) -> None:
        if not (root / "scans").is_dir() and (root / "library" / "scans").is_dir():
            root = root / "library"
        self.root = root
        self.is_library = (root / "scans").is_dir()
        if not root.is_dir():
            raise ViewError(f"{root}: no such folder: name a library or a result")
        self.only: Entry | None = result_entry(root) if (root / RECORD_FILE).is_file() else None
        self._known: dict[str, Entry] = {}
        self._derived: OrderedDict[str, Entry] = OrderedDict()
        self._lock = Lock()
        if not self.is_library and not self.list(ListFilter()).entries:
            raise ViewError(f"{root}: holds neither scans nor results: name a library or a result")

    def list(self, wanted: ListFilter) -> Listing:
        """Return the entries that match the filters; those of a library by time of the press, newest first.

        Raises
        ------
        LibraryError
            The library cannot be read.
        """
        found = self._of_library(wanted.query) if self.is_library else self._of_folder()
        entries, complaints = [], []
        for one in found:
            if isinstance(one, Entry):
                entries.append(one)
            else:
                complaints.append(one)
        with self._lock:
            self._known.update((entry.key, entry) for entry in entries)
        return Listing(tuple(one for one in entries if _answers(one, wanted.words)), tuple(complaints))

    def find(self, key: str) -> Entry:
        """Return the entry of that key.

        Raises
        ------
        ViewError
            No entry has that key.
        """
        with self._lock:
            found = self._derived.get(key) or self._known.get(key)
        if found is None:
            self.list(ListFilter())
            with self._lock:
                found = self._known.get(key)
        if found is None:
            raise ViewError("no such scan: go back to the list")
        return found

    def replace_entries(self, changed: Callable[[Entry], Entry]) -> None:
        """Put what `changed` makes of it in the place of each entry that was listed."""
        with self._lock:
            self._known = {key: changed(entry) for key, entry in self._known.items()}

    def add_derived(self, entry: Entry) -> None:
        """Add an entry that belongs to no library; beyond `MAX_DERIVED` the oldest is dropped."""
        with self._lock:
            self._derived[entry.key] = entry
            while len(self._derived) > MAX_DERIVED:
                self._derived.popitem(last=False)

    def _of_folder(self) -> Iterator[Entry | str]:
        if self.only is not None:
            yield self.only
            return
        for folder in _result_folders(self.root):
            try:
                yield result_entry(folder)
            except UnreadableResult as error:
                yield str(error)

    def _of_library(self, query: Query) -> Iterator[Entry | str]:
        library = Library(self.root)
        for hit in reversed(search(library, query)):
            scan = self.root / "scans" / hit.scan_id
            with self._lock:
                seen = self._known.get(key_of(scan))
            yield from _of_scan(scan, hit, seen)


def _of_scan(scan: Path, hit: Hit, seen: Entry | None) -> Iterator[Entry | str]:
    """Yield the results of a scan, newest first, or its quick look where it has none.

    Errors are yielded. `seen` is the quick look if it was read before.
    """
    shown = 0
    for folder in sorted(_result_folders(scan / "results"), key=_changed_ns, reverse=True):
        try:
            yield result_entry(folder, scan, hit)
        except UnreadableResult as error:
            yield str(error)
        else:
            shown += 1
    if not shown and seen is not None and seen.heights.is_file():
        yield replace(seen, hit=hit)
    elif not shown:
        try:
            record = read_scan(scan).record
            yield quick_look_entry(scan, hit, record.pixel_pitch_um, record.shape)
        except (UnreadableResult, DeviceError) as error:
            yield str(error)


def _result_folders(root: Path, depth: int = MAX_DEPTH) -> list[Path]:
    """Return folders with a record at or below a folder, sorted; links are not followed."""
    found: list[Path] = []
    waiting = [(root, depth)]
    while waiting and len(found) < MAX_RESULTS:
        folder, left = waiting.pop()
        try:
            if (folder / RECORD_FILE).is_file():
                found.append(folder)
            elif left:
                inside = sorted(folder.iterdir(), reverse=True) if folder.is_dir() else []
                waiting += [
                    (one, left - 1)
                    for one in inside
                    if one.is_dir() and not one.is_symlink() and not one.name.startswith(".")
                ]
        except OSError:
            continue  # the folder is not readable
    return found


def _changed_ns(folder: Path) -> int:
    """Return the time of the last change; 0 for a folder that was just removed."""
    try:
        return folder.stat().st_mtime_ns
    except OSError:
        return 0


def _answers(entry: Entry, words: tuple[str, ...]) -> bool:
    hit = entry.hit
    known = [entry.title, entry.kind, entry.record.name if entry.record else "", entry.folder.name]
    if hit is not None:
        facts: tuple[str | None, ...] = (hit.scan_id, hit.taken, hit.verdict, hit.job, hit.part, hit.gel)
        facts += (hit.operator, hit.device, hit.name)
        facts += (*hit.tags, hit.note)
        known += [fact for fact in facts if fact]
    text = "\n".join(known).casefold()
    return all(word.casefold() in text for word in words)
