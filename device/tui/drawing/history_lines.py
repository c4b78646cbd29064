"""The history in lines: what a scan's line and details say, and which scans are shown in which order."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final, Literal

from device.instrument.history import ScanEntry
from device.tui.drawing.advice import screen_advice
from device.tui.drawing.text import local_time, sticky_text

Order = Literal["newest first", "oldest first", "by part", "worst first"]
ORDERS: Final[tuple[Order, ...]] = ("newest first", "oldest first", "by part", "worst first")

_WORST_FIRST: Final = ("retake", "doubtful", "good")


def shown_level(entry: ScanEntry) -> str:
    """The verdict's level, or "doubtful" after a failed check of the check standard."""
    return "doubtful" if entry.doubt and entry.verdict.level == "good" else entry.verdict.level


def scan_line(entry: ScanEntry) -> str:
    """One line of the history: number, verdict, mark, whether it was offloaded, part."""
    mark = entry.mark.opinion or "" if entry.mark else ""
    sent = "yes" if entry.offloaded else ""
    return f"{entry.counter:>4} {shown_level(entry):<8} {mark:<4} {sent:<4} {entry.annotations.part or ''}"


def details_of(entry: ScanEntry) -> str:
    """Verdict, annotations, time, offload state and note of a scan."""
    sent = "verified on a workstation" if entry.offloaded else "not offloaded"
    note = f"\nNote: {entry.mark.note}" if entry.mark and entry.mark.note else ""
    doubt = f"! {entry.doubt}\n" if entry.doubt and entry.doubt != entry.verdict.reason else ""
    return (
        f"{doubt}{entry.verdict.level}: {screen_advice(entry.verdict.reason)}\n{sticky_text(entry.annotations)}\n"
        f"{local_time(entry.wall_time)} · {sent}{note}"
    )


def chosen_scans(scans: Iterable[ScanEntry], words: str, order: Order) -> tuple[ScanEntry, ...]:
    """The scans that hold every one of the words, in that order.

    scans : newest first
    words : parts of number ("#12"), level, "marked good", "sent" or "unsent", date, job, part, operator and notes
    """
    wanted = words.casefold().split()
    found = [entry for entry in scans if all(word in _searched(entry) for word in wanted)]
    match order:
        case "newest first":
            pass
        case "oldest first":
            found.reverse()
        case "by part":
            found.sort(key=lambda entry: (entry.annotations.part or "").casefold())
        case "worst first":
            found.sort(key=lambda entry: _WORST_FIRST.index(shown_level(entry)))
    return tuple(found)


def _searched(entry: ScanEntry) -> str:
    labels, mark = entry.annotations, entry.mark
    texts = (
        f"#{entry.counter}",
        shown_level(entry),
        f"marked {mark.opinion}" if mark and mark.opinion else "unmarked",
        "sent" if entry.offloaded else "unsent",
        local_time(entry.wall_time),
        labels.job,
        labels.part,
        labels.operator,
        labels.note,
        mark.note if mark else "",
    )
    return "\n".join(text for text in texts if text).casefold()
