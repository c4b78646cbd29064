"""What a batch left in a library, to compare it with what another way of working left."""

from __future__ import annotations

import json

import msgspec

from host_sync.batch.library_batch import ScanOutcome
from host_sync.library.library import Library


class Said(msgspec.Struct):
    """What the command prints as JSON."""

    scans: tuple[ScanOutcome, ...]


def contents(library: Library) -> dict[str, object]:
    """Every file of results by place, without the time it was written; hidden ones too."""
    found: dict[str, object] = {}
    for path in library.root.rglob("results/**/*"):
        if path.is_file():
            place = str(path.relative_to(library.root))
            found[place] = path.read_bytes()
            if path.name == "result.json":
                found[place] = {
                    key: value for key, value in json.loads(path.read_bytes()).items() if key != "written_utc"
                }
    return found


def plain(outcomes: list[ScanOutcome], library: Library) -> list[tuple[str, str | None, tuple[str, ...], str | None]]:
    """Outcomes by scan, with places relative to the library."""
    root = str(library.root)
    return sorted(
        (
            one.scan,
            None if one.folder is None else str(one.folder.relative_to(root)),
            one.warnings,
            None if one.reason is None else one.reason.replace(root, "LIB"),
        )
        for one in outcomes
    )
