"""Changes the label of a scan from the page: the name, tags and note that `retrosync list SCAN --set-name` gives."""

from __future__ import annotations

from typing import Final

import msgspec

from host_sync.errors import ViewError
from host_sync.library.labels import Label, label_scan
from host_sync.library.library import Library
from host_sync.viewer.catalogue import Catalogue
from host_sync.viewer.entry import Entry, relabelled

NO_LIBRARY: Final = "only scans of a library have a label: pull them into one"


class _LabelRequest(msgspec.Struct, forbid_unknown_fields=True):
    """The whole label as the page has it now, and as it loaded it."""

    name: str
    tags: list[str]
    note: str
    loaded: Label


def change_label(catalogue: Catalogue, key: str, body: bytes) -> Entry:
    """The entry with the label of a request, which the library keeps in `labels.json`; scans themselves stay as they
    are.

    Raises
    ------
    ViewError
        The entry is of no library, or the request is not valid.
    LibraryError
        The label was changed since the page loaded it, a text is too long, a tag has a blank or comma, or the library
        cannot be written.
    """
    entry = catalogue.find(key)
    if entry.hit is None or not catalogue.is_library:
        raise ViewError(NO_LIBRARY)
    try:
        asked = msgspec.json.decode(body, type=_LabelRequest)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ViewError("the label is not valid: load the page again") from error
    library, scan_id = Library(catalogue.root), entry.hit.scan_id
    gone, loaded = set(asked.loaded.tags) - set(asked.tags), asked.loaded
    label = label_scan(library, scan_id, name=asked.name, tag=asked.tags, untag=gone, note=asked.note, loaded=loaded)
    catalogue.replace_entries(lambda one: relabelled(one, scan_id, label))
    return relabelled(entry, scan_id, label)
