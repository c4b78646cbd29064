"""The surfaces of a library that look most like one."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from device.errors import DeviceError
from device.io.atomic import RESULTS
from device.surface.fields import Float32Array
from host_sync.errors import HostError, Indescribable, LibraryError
from host_sync.library.library import Library
from host_sync.likeness.descriptor import describe_result
from host_sync.likeness.index import Entry, LikenessIndex
from host_sync.likeness.whitening import whitening
from host_sync.results.files import RECORD_FILE
from host_sync.results.reader import read_result

KEPT_EVERY: Final = 50
"""Results after which the index is brought to the disk, so that a killed run loses little."""


@dataclass(frozen=True, slots=True)
class Alike:
    """A result that looks like the one asked for.

    distance : RMS difference of the descriptors' figures after whitening
    """

    scan: str
    folder: Path
    distance: float


@dataclass(frozen=True, slots=True)
class Answer:
    """The most alike results first, and what could not be compared.

    compared : number of results that the question was compared with
    left_out : scan and reason of every result without a descriptor
    unreadable : scan and reason of every result that cannot be read
    without_results : scans that have none
    """

    found: tuple[Alike, ...]
    compared: int
    left_out: tuple[tuple[str, str], ...]
    unreadable: tuple[tuple[str, str], ...] = ()
    without_results: tuple[str, ...] = ()


def nearest(row: Float32Array, rows: Float32Array, count: int) -> list[tuple[int, float]]:
    """Numbers and distances of the `count` rows that are nearest, nearest first.

    row, rows : float32 arrays of shape (LENGTH,) and (N, LENGTH)
    """
    if not len(rows):
        return []
    off = (rows - row) @ whitening()
    distances = np.sqrt(np.mean(off * off, axis=1))
    return [(int(at), float(distances[at])) for at in np.argsort(distances, kind="stable")[:count]]


def alike(result: Path, library: Path, count: int = 5, tell: Callable[[str], None] = lambda _: None) -> Answer:
    """The results of a library that look most like one, each scan with its newest; the index is updated first.

    result : folder of the result that is asked for; it is not among the answers
    tell : receives what is done at the moment

    Raises
    ------
    Indescribable
        The result asked for has no contact to compare.
    UnreadableResult
        It cannot be read.
    LibraryError
        The library cannot be read, or holds no scans.
    """
    asked = describe_result(read_result(result, samples=False))
    gaps = Gaps([], [])
    entries = updated(library, tell, gaps)
    if not (entries or gaps.unreadable or gaps.without_results):
        raise LibraryError(f"{library}: holds no scans: pull some first")
    own, root = result.resolve(), library.resolve()
    own_folder = own.relative_to(root).as_posix() if own.is_relative_to(root) else ""
    held = [(folder, entry.row) for folder, entry in entries.items() if entry.row is not None and folder != own_folder]
    found = nearest(asked, np.array([row for _, row in held], np.float32), count)
    return Answer(
        tuple(Alike(_scan(held[at][0]), library / held[at][0], distance) for at, distance in found),
        len(held),
        tuple((_scan(folder), entry.reason or "") for folder, entry in entries.items() if entry.row is None),
        tuple(gaps.unreadable),
        tuple(gaps.without_results),
    )


@dataclass(frozen=True, slots=True)
class Gaps:
    """Scans that an index lacks.

    unreadable : with the reason
    without_results : by name
    """

    unreadable: list[tuple[str, str]]
    without_results: list[str]


def updated(library: Path, tell: Callable[[str], None] = lambda _: None, gaps: Gaps | None = None) -> dict[str, Entry]:
    """Every entry of a library's index after new and changed results were described and lost ones dropped.

    Keys are folders relative to the library. Every entry is described again where the index is damaged.

    gaps : receives what has no entry
    """
    gaps = gaps or Gaps([], [])
    held_library = Library(library)
    held_library.require()
    if not (library / "scans").is_dir():
        raise LibraryError(f"{library}: holds no scans: pull some first")
    with held_library.translating("read"), LikenessIndex(library) as index:
        held = index.read()
        current: dict[str, Entry] = {}
        fresh = 0
        for folder, stamp in _newest_results(library, gaps.without_results):
            entry = held.get(folder)
            if entry is None or entry.stamp != stamp:
                tell(f"describing {_scan(folder)}")
                try:
                    entry = _described(library / folder, stamp)
                except (DeviceError, HostError) as error:
                    gaps.unreadable.append((_scan(folder), str(error)))
                    continue  # it is tried again in the next search
                index.put(folder, entry)
                fresh += 1
                if fresh % KEPT_EVERY == 0:
                    index.keep()
            current[folder] = entry
        for folder in held.keys() - current.keys():
            index.drop(folder)
        return current


def _described(folder: Path, stamp: str) -> Entry:
    try:
        return Entry(stamp, describe_result(read_result(folder, samples=False)), None)
    except Indescribable as error:
        return Entry(stamp, None, str(error))


def _newest_results(library: Path, without: list[str]) -> Iterator[tuple[str, str]]:
    """Folder of each scan's newest result, relative to the library, and the stamp of its record.

    without : receives the scans that have no results

    Plain strings: a path object for each of ten thousand scans takes longer than to ask the disk.
    """
    root = os.fspath(library)
    for scan in sorted(one.name for one in os.scandir(f"{root}/scans") if one.is_dir() and one.name[0] != "."):
        results = f"scans/{scan}/{RESULTS}"
        try:
            with os.scandir(f"{root}/{results}") as found:
                places = [one for one in found if not one.name.startswith(".")]
        except OSError:
            places = []
        if not places:
            without.append(scan)
            continue
        newest = places[0] if len(places) == 1 else max(places, key=lambda one: one.stat().st_mtime_ns)
        try:
            facts = os.stat(f"{root}/{results}/{newest.name}/{RECORD_FILE}")  # noqa: PTH116 - see above
        except OSError:
            yield f"{results}/{newest.name}", "no record"
        else:
            yield f"{results}/{newest.name}", f"{facts.st_mtime_ns} {facts.st_size}"


def _scan(folder: str) -> str:
    return folder.split("/")[1]
