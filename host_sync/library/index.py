"""The index of a library: one SQLite file for searching that only repeats what the folders say; delete it at will.

Before each use it is updated from the folders. A damaged one, or one of another version, is rebuilt; a library that
cannot be written, or whose disk is full, gets one in memory. A bundle that cannot be read is a row that says why.
"""

from __future__ import annotations

import sqlite3
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from datetime import UTC, date
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, Final

from device.bundles.bundle import MANIFESTS, BundleKind, bundle_ids
from device.bundles.calibration import CalibrationBundle, read_calibration
from device.bundles.scan import read_scan
from device.errors import RecordError
from host_sync.library.labels import Label, read_labels
from host_sync.library.library import AnyBundle, Library

INDEX_FILE: Final = "index.sqlite3"
IN_MEMORY: Final = Path(":memory:")
_VERSION: Final = 3
_REPLACED: Final = "(SELECT newer.id FROM bundle AS newer WHERE newer.replaces = bundle.id)"
_HIT: Final = f"id, taken, verdict, job, part, gel, operator, device, reason, {_REPLACED}"
_TABLES: Final = """
CREATE TABLE bundle (kind TEXT, id TEXT, stamp TEXT, damage TEXT, device TEXT, counter INTEGER, taken TEXT, board TEXT,
    gel TEXT, job TEXT, part TEXT, operator TEXT, verdict TEXT, reason TEXT, calibration TEXT, replaces TEXT,
    PRIMARY KEY (kind, id));
CREATE TABLE file (kind TEXT, id TEXT, name TEXT, sha256 TEXT, size INTEGER,
    FOREIGN KEY (kind, id) REFERENCES bundle ON DELETE CASCADE);
CREATE INDEX file_by_hash ON file (sha256);
CREATE INDEX bundle_by_replaced ON bundle (replaces);
"""


@dataclass(frozen=True, slots=True)
class Query:
    """Conditions on a scan; None matches everything. Texts may use * and ? and ignore case.

    name, tag, note : of the label that people gave it
    text : words that stand somewhere in what is known of it, each
    since, until : days by the device's own clock, which may be wrong; both inclusive
    """

    job: str | None = None
    part: str | None = None
    operator: str | None = None
    verdict: str | None = None
    gel: str | None = None
    device: str | None = None
    since: date | None = None
    until: date | None = None
    name: str | None = None
    tag: str | None = None
    note: str | None = None
    text: str | None = None


@dataclass(frozen=True, slots=True)
class Hit:
    """A scan that matches a query; `taken` is by the device's clock, `reason` is the verdict's.

    replaced_by : id of the scan of this library that was taken instead of it; None without one
    name, tags, note : its label
    """

    scan_id: str
    taken: str
    verdict: str
    job: str | None
    part: str | None
    gel: str
    operator: str | None
    device: str
    reason: str
    replaced_by: str | None = None
    name: str = ""
    tags: tuple[str, ...] = ()
    note: str = ""


def search(library: Library, query: Query) -> list[Hit]:
    """Return the scans that match a query, by device and in the order of their presses.

    Raises
    ------
    LibraryError
        The library cannot be read.
    """
    texts = {name: getattr(query, name) for name in ("job", "part", "operator", "verdict", "gel", "device")}
    given = {name: text for name, text in texts.items() if text is not None}
    clauses = ["kind = 'scans'", "damage IS NULL", *(f"lower({name}) GLOB lower(:{name})" for name in given)]
    days = {name: day.isoformat() for name, day in (("since", query.since), ("until", query.until)) if day is not None}
    clauses += [f"substr(taken, 1, 10) {'>=' if name == 'since' else '<='} :{name}" for name in days]
    # Only column names from this file are put into the text; every value is a parameter.
    sql = f"SELECT {_HIT} FROM bundle WHERE {' AND '.join(clauses)} ORDER BY device, counter"  # noqa: S608
    labels = read_labels(library.root).scans
    hits = (_labelled(Hit(*row), labels.get(str(row[0]), Label())) for row in _ask(library, sql, given | days))
    return [hit for hit in hits if _answers(hit, query)]


def _labelled(hit: Hit, label: Label) -> Hit:
    return replace(hit, name=label.name, tags=label.tags, note=label.note)


def _answers(hit: Hit, query: Query) -> bool:
    """Return whether a hit meets the conditions on its label and on its text."""
    for wanted, values in ((query.name, (hit.name,)), (query.tag, hit.tags), (query.note, (hit.note,))):
        if wanted is not None and not any(fnmatchcase(one.casefold(), wanted.casefold()) for one in values if one):
            return False
    facts = (hit.scan_id, hit.taken, hit.verdict, hit.job, hit.part, hit.gel, hit.operator, hit.device, hit.reason)
    known = "\n".join(
        str(one) for one in (*facts, hit.replaced_by and "replaced", hit.name, *hit.tags, hit.note) if one
    ).casefold()
    return all(word.casefold() in known for word in (query.text or "").split())


def damaged_bundles(library: Library) -> list[str]:
    """Return a sentence for each bundle of the library that cannot be read.

    Raises
    ------
    LibraryError
        The library cannot be read.
    """
    rows = _ask(library, "SELECT damage FROM bundle WHERE damage IS NOT NULL ORDER BY kind, id", {})
    return [str(damage) for (damage,) in rows]


def files_by_hash(library: Library) -> dict[str, Path]:
    """Return a file of the library for each SHA-256 in its manifests: hash it before trusting it."""
    rows = _ask(library, "SELECT sha256, kind, id, name FROM file", {})
    return {sha256: library.root / kind / bundle_id / name for sha256, kind, bundle_id, name in rows}


def _ask(library: Library, sql: str, values: dict[str, str]) -> list[tuple[Any, ...]]:
    """Return rows of an up-to-date index; a damaged one is rebuilt first."""
    library.require()
    path = library.root / INDEX_FILE
    with library.translating("read"):
        try:
            return _ask_once(path, library.root, sql, values)
        except (sqlite3.DatabaseError, UnicodeDecodeError):
            with suppress(OSError):
                path.unlink(missing_ok=True)
        try:
            return _ask_once(path, library.root, sql, values)
        except sqlite3.DatabaseError:  # its disk is full, or lies
            return _ask_once(IN_MEMORY, library.root, sql, values)


def _ask_once(path: Path, root: Path, sql: str, values: dict[str, str]) -> list[tuple[Any, ...]]:
    with closing(_open(path)) as index:
        if index.execute("PRAGMA quick_check").fetchone() != ("ok",):
            raise sqlite3.DatabaseError("the index is damaged")
        _update(index, root)
        return index.execute(sql, values).fetchall()


def _open(path: Path) -> sqlite3.Connection:
    """Return the index in a file, empty when new or of another version; in memory when the file cannot be opened."""
    try:
        return _prepared(sqlite3.connect(path, timeout=30.0))
    except sqlite3.OperationalError:
        return _prepared(sqlite3.connect(IN_MEMORY))


def _prepared(index: sqlite3.Connection) -> sqlite3.Connection:
    try:
        with index:
            _prepare(index)
    except BaseException:
        index.close()
        raise
    return index


def _prepare(index: sqlite3.Connection) -> None:
    index.execute("PRAGMA foreign_keys = ON")
    if index.execute("PRAGMA user_version").fetchone()[0] != _VERSION:
        tables = [name for (name,) in index.execute("SELECT name FROM sqlite_master WHERE type = 'table'")]
        for table in sorted(tables, reverse=True):
            index.execute(f'DROP TABLE "{table}"')
        index.executescript(f"{_TABLES} PRAGMA user_version = {_VERSION};")


def _update(index: sqlite3.Connection, root: Path) -> None:
    """Make the rows agree with the folders; unchanged manifests are not read again."""
    with index:
        for kind in MANIFESTS:
            known = dict(index.execute("SELECT id, stamp FROM bundle WHERE kind = ?", (kind,)).fetchall())
            present = {bundle_id: _stamp(root / kind / bundle_id, kind) for bundle_id in bundle_ids(root, kind)}
            for bundle_id in known.keys() - present.keys():
                index.execute("DELETE FROM bundle WHERE kind = ? AND id = ?", (kind, bundle_id))
            for bundle_id, stamp in present.items():
                if known.get(bundle_id) != stamp:
                    index.execute("DELETE FROM bundle WHERE kind = ? AND id = ?", (kind, bundle_id))
                    _add(index, kind, root / kind / bundle_id, stamp)


def _stamp(directory: Path, kind: BundleKind) -> str:
    try:
        facts = (directory / MANIFESTS[kind]).lstat()
    except OSError:
        return "absent"
    return f"{facts.st_ino}:{facts.st_size}:{facts.st_mtime_ns}"


def _add(index: sqlite3.Connection, kind: BundleKind, directory: Path, stamp: str) -> None:
    """One bundle's rows; whatever is wrong with it stays in its own row."""
    index.execute("SAVEPOINT bundle")
    try:
        bundle: AnyBundle = read_scan(directory) if kind == "scans" else read_calibration(directory)
        _insert(index, kind, bundle, stamp)
    except (RecordError, OSError, ValueError, OverflowError, sqlite3.IntegrityError, sqlite3.DataError) as error:
        index.execute("ROLLBACK TO bundle")
        reason = str(error) if isinstance(error, RecordError) else f"{directory}: cannot be indexed ({error})"
        index.execute(
            "INSERT INTO bundle (kind, id, stamp, damage) VALUES (?, ?, ?, ?)",
            # Without a stamp: the next update tries again, as the error may have been the disk's.
            (kind, directory.name, "", reason.encode(errors="replace").decode()),
        )
    index.execute("RELEASE bundle")


def _insert(index: sqlite3.Connection, kind: BundleKind, bundle: AnyBundle, stamp: str) -> None:
    bundle_id = bundle.bundle_id
    row = {"kind": kind, "id": bundle_id, "stamp": stamp} | _facts(bundle)
    columns = ", ".join(row)
    values = ", ".join(f":{name}" for name in row)
    index.execute(f"INSERT INTO bundle ({columns}) VALUES ({values})", row)  # noqa: S608
    index.executemany(
        "INSERT INTO file VALUES (?, ?, ?, ?, ?)",
        [(kind, bundle_id, name, entry.sha256, entry.size) for name, entry in bundle.record.files.items()],
    )


def _facts(bundle: AnyBundle) -> dict[str, str | int | None]:
    """Return the columns of a bundle's row."""
    record = bundle.record
    facts: dict[str, str | int | None] = {
        "device": record.identity.device_id,
        "counter": record.identity.counter,
        "board": record.board,
        "gel": record.gel_id,
    }
    if isinstance(bundle, CalibrationBundle):
        return facts | {"taken": bundle.record.created.astimezone(UTC).isoformat()}
    scan = bundle.record
    return facts | {
        "taken": scan.wall_time.astimezone(UTC).isoformat(),
        "job": scan.annotations.job,
        "part": scan.annotations.part,
        "operator": scan.annotations.operator,
        "verdict": scan.verdict.level,
        "reason": scan.verdict.reason,
        "calibration": scan.calibration_id,
        "replaces": scan.replaces,
    }
