"""Scans of a library that were taken again: the handheld's record of the later scan names the one it replaces."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import msgspec

from device.bundles.scan import SCAN_MANIFEST


class _Manifest(msgspec.Struct, frozen=True):
    """Fields that are read from a scan's manifest."""

    replaces: str | None = None


def replacing(scan: Path) -> str | None:
    """Id of the scan that replaces the one in a folder of a library; None without one.

    A replacement that the library does not hold replaces nothing there.
    """
    try:
        return _replaced_in(scan.parent, scan.parent.stat().st_mtime_ns).get(scan.name)
    except OSError:
        return None


@lru_cache(maxsize=4)
def _replaced_in(scans: Path, _changed_ns: int) -> dict[str, str]:
    """Id of the replacing scan by that of the replaced one; read again once a scan comes or goes."""
    found = {}
    for manifest in sorted(scans.glob(f"*/{SCAN_MANIFEST}")):
        try:
            content = manifest.read_bytes()
            # Most scans replace none: not decoding those saves nearly all of the time.
            old = msgspec.json.decode(content, type=_Manifest).replaces if b'"replaces": "' in content else None
        except (OSError, ValueError):
            continue
        if old is not None:
            found[old] = manifest.parent.name
    return found
