"""Which scans the words on Scans find."""

from __future__ import annotations

from datetime import UTC, datetime

import pytest

from device.bundles.scan import Annotations, VerdictLevel, VerdictRecord
from device.instrument.history import ScanEntry
from device.store.choices import Opinion, ScanMark
from device.tui.screens.scans import chosen_scans


def scan(
    number: int, level: VerdictLevel = "good", part: str = "", *, sent: bool = False, opinion: Opinion | None = None
) -> ScanEntry:
    return ScanEntry(
        scan_id=f"scan-{number}",
        counter=number,
        wall_time=datetime(2026, 11, 22, tzinfo=UTC),
        gel_id="gel",
        calibration_id=None,
        verdict=VerdictRecord(level=level, reason="", figures={}),
        annotations=Annotations(part=part or None),
        offloaded=sent,
        mark=ScanMark(scan_id=f"scan-{number}", opinion=opinion) if opinion else None,
    )


SCANS = (
    scan(120, "doubtful", "sent back"),
    scan(12, opinion="bad"),
    scan(11, "retake", opinion="good"),
    scan(1, sent=True),
)


@pytest.mark.parametrize(
    ("words", "numbers"),
    [
        ("#12", [12]),
        ("#1", [1]),
        ("sent", [1]),
        ("unsent", [120, 12, 11]),
        ("marked good", [11]),
        ("marked", [12, 11]),
        ("unmarked", [120, 1]),
        ("unmarked good", [1]),
        ("good", [12, 1]),
        ("BACK", [120]),
        ("unsent  marked   bad", [12]),
        ("#", []),
        ("", [120, 12, 11, 1]),
    ],
)
def test_words_find_what_they_say(words: str, numbers: list[int]) -> None:
    assert [entry.counter for entry in chosen_scans(SCANS, words, "newest first")] == numbers
