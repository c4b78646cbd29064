"""Labels of scans, written after they were pulled: a name, tags, a note; and searches that they keep.

Bundles are not touched: labels lie in `labels.json` of the library, by scan, and may be deleted at any time.
"""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Annotated, Final, Protocol

import msgspec

from device.io.atomic import replace_file
from hal.validation import decode_json, explain_validation
from host_sync.errors import LibraryError

LABELS_FILE: Final = "labels.json"
MAX_BYTES: Final = 64 << 20

Name = Annotated[str, msgspec.Meta(max_length=120)]
Tag = Annotated[str, msgspec.Meta(min_length=1, max_length=60, pattern=r"^[^\s,]+$")]
Note = Annotated[str, msgspec.Meta(max_length=4000)]


class Label(msgspec.Struct, frozen=True, omit_defaults=True):
    """The label of one scan."""

    name: Name = ""
    tags: tuple[Tag, ...] = ()
    note: Note = ""


class Labels(msgspec.Struct, frozen=True, omit_defaults=True):
    """The whole file.

    scans : labels by scan id
    searches : conditions by the name that a search was saved under
    """

    schema: str = "retrograph.labels/1"
    scans: dict[str, Label] = {}
    searches: dict[str, dict[str, str]] = {}


def read_labels(root: Path) -> Labels:
    """Return the labels of a library; empty without a file.

    Raises
    ------
    LibraryError
        The file is damaged.
    """
    path = root / LABELS_FILE
    try:
        if not path.is_file():
            return Labels()
        data = path.read_bytes() if path.stat().st_size <= MAX_BYTES else b""
        return decode_json(data, Labels)
    except OSError as error:
        raise LibraryError(f"{path}: cannot be read ({error.strerror}): allow that to you, or move it away") from error
    except msgspec.DecodeError as error:
        raise LibraryError(f"{path}: is damaged ({error}): mend it, or move it away") from error


class LabelledLibrary(Protocol):
    """A library's folder, its lock, and its sentences for the system's errors; see `Library`."""

    @property
    def root(self) -> Path:
        """Folder of the library."""

    def writing(self) -> AbstractContextManager[None]:
        """Hold the library's lock."""

    def translating(self, verb: str) -> AbstractContextManager[None]:
        """Turn the system's errors into `LibraryError`."""


def label_scan(
    library: LabelledLibrary,
    scan_id: str,
    *,
    name: str | None = None,
    tag: Iterable[str] = (),
    untag: Iterable[str] = (),
    note: str | None = None,
    loaded: Label | None = None,
) -> Label:
    """Change the label of a scan and return it; None and nothing leave a part as it is, an empty text removes it.

    loaded : the label that the change was made from; any by default

    Raises
    ------
    LibraryError
        The label is no longer the one that was loaded, a text is too long, a tag has a blank or comma, or the library
        cannot be written.
    """
    with library.writing():
        labels = read_labels(library.root)
        old = labels.scans.get(scan_id, Label())
        if loaded is not None and loaded != old:
            raise LibraryError(f"the label of {scan_id} was changed meanwhile: load it again")
        gone = set(untag)
        tags = tuple(dict.fromkeys(one for one in (*old.tags, *tag) if one not in gone))
        given = {"name": old.name if name is None else name, "tags": tags, "note": old.note if note is None else note}
        try:
            new = msgspec.convert(given, Label)
        except msgspec.ValidationError as error:
            raise LibraryError(
                f"{explain_validation(error)}: tags are words without blanks and commas; names are short"
            ) from error
        scans = {**labels.scans, scan_id: new}
        if new == Label():
            del scans[scan_id]
        _write(library, msgspec.structs.replace(labels, scans=scans))
    return new


def save_search(library: LabelledLibrary, name: str, conditions: dict[str, str]) -> None:
    """Keep a search under a name; one without conditions is removed.

    Raises
    ------
    LibraryError
        The library cannot be written.
    """
    with library.writing():
        labels = read_labels(library.root)
        searches = {**labels.searches, name: conditions}
        if not conditions:
            searches.pop(name)
        _write(library, msgspec.structs.replace(labels, searches=searches))


def _write(library: LabelledLibrary, labels: Labels) -> None:
    data = msgspec.json.format(msgspec.json.encode(labels), indent=2)
    with library.translating("written"):
        replace_file(library.root / LABELS_FILE, data)
