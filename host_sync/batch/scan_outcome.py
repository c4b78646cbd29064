"""Outcome of the reconstruction of one scan."""

from __future__ import annotations

from pathlib import Path

import msgspec


class ScanOutcome(msgspec.Struct, frozen=True, omit_defaults=True):
    """A folder of results and its doubts, or the reason why there is none."""

    scan: str
    folder: Path | None = None
    warnings: tuple[str, ...] = ()
    reason: str | None = None
