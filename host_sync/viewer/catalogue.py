"""What a library, a folder of results or one result has to show, and which of it answers to the filters."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from threading import Lock
from typing import Final

from device.errors import RecordError
from device.scan_bundle import read_scan
from host_sync.errors import ViewError
from host_sync.library import Library
from host_sync.library_index import Hit, Query, search
from host_sync.viewer.entry import RECORD_FILE, Entry, key_of, quick_look_entry, result_entry

DEEPEST: Final = 3
"""Folders of results are looked for so many levels below the one that was named."""

MOST_RESULTS: Final = 5000
MOST_DERIVED: Final = 16


@dataclass(frozen=True, slots=True)
class Wanted:
    """What the page filters by.

    words : all of them must occur in what is known of a scan
    """

    query: Query = field(default_factory=Query)
    words: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Listing:
    """The entries that answer, and a sentence for each thing that cannot be shown."""

    entries: tuple[Entry, ...]
    complaints: tuple[str, ...]


class Catalogue:
    """Finds entries by key, and lists them; the folders are the truth and are looked at each time.

    Parameters
    ----------
    root : a library, a folder with results in it, or one result

    Raises
    ------
    ViewError
        It is none of these.
    """

    def __init__(self, root: Path) -> None:
        self.root = root
        self.is_library = (root / "scans").is_dir()
        if not root.is_dir():
            raise ViewError(f"{root}: there is no such folder: name a library or a result")
        self.only: Entry | None = result_entry(root) if (root / RECORD_FILE).is_file() else None
        self._known: dict[str, Entry] = {}
        self._derived: OrderedDict[str, Entry] = OrderedDict()
        self._lock = Lock()
        if not self.is_library and not self.list(Wanted()).entries:
            raise ViewError(f"{root}: holds neither scans nor results: name a library or a result")

    def list(self, wanted: Wanted) -> Listing:
        """The entries that answer to the filters; those of a library in the order of their presses, newest first.

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
        """The entry of that key.

        Raises
        ------
        ViewError
            There is none.
        """
        with self._lock:
            found = self._derived.get(key) or self._known.get(key)
        if found is None:
            self.list(Wanted())
            with self._lock:
                found = self._known.get(key)
        if found is None:
            raise ViewError("there is no such scan here: go back to the list")
        return found

    def keep(self, entry: Entry) -> None:
        """Make an entry that lies in no library known; the oldest of many is forgotten."""
        with self._lock:
            self._derived[entry.key] = entry
            while len(self._derived) > MOST_DERIVED:
                self._derived.popitem(last=False)

    def _of_folder(self) -> Iterator[Entry | str]:
        if self.only is not None:
            yield self.only
            return
        for folder in _result_folders(self.root):
            try:
                yield result_entry(folder)
            except ViewError as error:
                yield str(error)

    def _of_library(self, query: Query) -> Iterator[Entry | str]:
        library = Library(self.root)
        for hit in reversed(search(library, query)):
            scan = self.root / "scans" / hit.scan_id
            with self._lock:
                seen = self._known.get(key_of(scan))
            yield from _of_scan(scan, hit, seen)


def _of_scan(scan: Path, hit: Hit, seen: Entry | None) -> Iterator[Entry | str]:
    """The results of a scan, newest first, else its quick look: `seen`, if it was read before."""
    shown = 0
    for folder in sorted(_result_folders(scan / "results"), key=_changed_ns, reverse=True):
        try:
            yield result_entry(folder, scan, hit)
        except ViewError as error:
            yield str(error)
        else:
            shown += 1
    if not shown and seen is not None and seen.heights.is_file():
        yield replace(seen, hit=hit)
    elif not shown:
        try:
            record = read_scan(scan).record
            yield quick_look_entry(scan, hit, record.pixel_pitch_um, record.shape[1])
        except (ViewError, RecordError) as error:
            yield str(error)


def _result_folders(root: Path, depth: int = DEEPEST) -> list[Path]:
    """Folders with a record of results at or below a folder, sorted; links are not followed."""
    found: list[Path] = []
    waiting = [(root, depth)]
    while waiting and len(found) < MOST_RESULTS:
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
            continue  # a folder that may not be read shows nothing
    return found


def _changed_ns(folder: Path) -> int:
    """When a folder was last changed; one that has just vanished is the oldest."""
    try:
        return folder.stat().st_mtime_ns
    except OSError:
        return 0


def _answers(entry: Entry, words: tuple[str, ...]) -> bool:
    hit = entry.hit
    known = [entry.title, entry.kind, str(entry.record.get("name", "")), entry.folder.name]
    if hit is not None:
        facts = (hit.scan_id, hit.taken, hit.verdict, hit.job, hit.part, hit.gel, hit.operator, hit.device)
        known += [fact for fact in facts if fact]
    text = "\n".join(known).casefold()
    return all(word.casefold() in text for word in words)
