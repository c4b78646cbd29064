"""The history in lines: what a scan's line and details say, and which scans are shown in which order."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Final, Literal

import numpy as np

from device.bundles.scan import MovieRecord
from device.instrument.history import ScanEntry
from device.surface.fields import Float64Array
from device.tui.drawing.cells import ColourDepth
from device.tui.drawing.relief import EIGHTHS, HALVES
from device.tui.drawing.text import local_time, screen_advice, sticky_text

BARS: Final = 7
"""Bars of either, so that both fit in a line beside the history on a screen of 80 columns."""


def movie_text(movie: MovieRecord, depth: ColourDepth) -> str:
    """Return contact and depth over the press with the largest value of each, in a line; a frame without one has no
    bar."""
    time_ms = np.array([frame.at_ms for frame in movie.frames])
    contact = np.array([frame.contact_fraction for frame in movie.frames], np.float64)
    depth_um = np.array([frame.depth_um for frame in movie.frames], np.float64)
    blocks = EIGHTHS if depth == "full" else HALVES
    parts = [
        f"{name} {_bars(time_ms, values, blocks)} {np.nanmax(values):.0f} {unit}"
        for name, values, unit in (("contact", 100.0 * contact, "%"), ("depth", depth_um, "µm"))
        if np.isfinite(values).any()
    ]
    text = ", ".join(parts)
    return f"{text[:1].upper()}{text[1:]}"


def _bars(time_ms: Float64Array, values: Float64Array, blocks: str) -> str:
    """Return bars from zero to the largest value, at even times; each that of the frame nearest in time."""
    count = min(BARS, values.size)
    at_ms = np.linspace(time_ms[0], time_ms[-1], count)
    nearest = np.abs(time_ms[None, :] - at_ms[:, None]).argmin(axis=1)
    share = values[nearest] / max(float(np.nanmax(values)), 1e-9)
    level = np.clip(np.ceil(np.nan_to_num(share) * (len(blocks) - 1)), 0, len(blocks) - 1).astype(int)
    return "".join(blocks[one] for one in level)


Order = Literal["newest first", "oldest first", "by part", "worst first"]
ORDERS: Final[tuple[Order, ...]] = ("newest first", "oldest first", "by part", "worst first")

_WORD: Final = re.compile(r"marked\s+(?:good|bad)\b|\S+")
_NUMBER: Final = re.compile(r"#\d+")
_KINDS: Final = ("marked", "marked good", "marked bad", "unmarked", "sent", "unsent", "replaced")
"""Words that say of which kind a scan is: whole, as "unsent" holds "sent"."""

_WORST_FIRST: Final = ("retake", "doubtful", "good")


def shown_level(entry: ScanEntry) -> str:
    """Return the verdict's level, or "doubtful" after a failed check of the check standard."""
    return "doubtful" if entry.doubt and entry.verdict.level == "good" else entry.verdict.level


def scan_line(entry: ScanEntry) -> str:
    """Return one line of the history: number, verdict, mark, whether it was offloaded, part."""
    mark = entry.mark.opinion or "" if entry.mark else ""
    sent = "yes" if entry.offloaded else ""
    return f"{entry.counter:>4} {shown_level(entry):<8} {mark:<4} {sent:<4} {entry.annotations.part or ''}"


def details_of(entry: ScanEntry, depth: ColourDepth) -> str:
    """Return the verdict, annotations, time, offload state and note of a scan, and the press over time where it is a
    movie."""
    sent = "verified on a workstation" if entry.offloaded else "not offloaded"
    replaced = f" · replaced by #{entry.replaced_by}" if entry.replaced_by is not None else ""
    note = f"\nNote: {entry.mark.note}" if entry.mark and entry.mark.note else ""
    movie = f"\n{movie_text(entry.movie, depth)}" if entry.movie else ""
    doubt = f"! {entry.doubt}\n" if entry.doubt and entry.doubt != entry.verdict.reason else ""
    return (
        f"{doubt}{entry.verdict.level}: {screen_advice(entry.verdict.reason)}\n{sticky_text(entry.annotations)}\n"
        f"{local_time(entry.wall_time)} · {sent}{replaced}{note}{movie}"
    )


def chosen_scans(scans: Iterable[ScanEntry], words: str, order: Order) -> tuple[ScanEntry, ...]:
    """Return the scans that hold every one of the words, in that order.

    scans : newest first
    words : number ("#12"), "marked good", "unmarked", "sent", "unsent" or "replaced", whole; or parts of level, date,
        job, part, operator and notes
    """
    wanted = _WORD.findall(words.casefold())
    found = [entry for entry in scans if all(_holds(entry, word) for word in wanted)]
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


def _holds(entry: ScanEntry, word: str) -> bool:
    """Return whether a scan is of the kind that a word names, or holds the word in its texts."""
    word = " ".join(word.split())
    if _NUMBER.fullmatch(word) or word in _KINDS:
        return word in _kinds(entry)
    return word in _searched(entry)


def _kinds(entry: ScanEntry) -> tuple[str, ...]:
    opinion = entry.mark.opinion if entry.mark else None
    return (
        f"#{entry.counter}",
        *(("marked", f"marked {opinion}") if opinion else ("unmarked",)),
        "sent" if entry.offloaded else "unsent",
        *(("replaced",) if entry.replaced_by is not None else ()),
    )


def _searched(entry: ScanEntry) -> str:
    labels, mark = entry.annotations, entry.mark
    texts = (
        shown_level(entry),
        local_time(entry.wall_time),
        labels.job,
        labels.part,
        labels.operator,
        labels.note,
        mark.note if mark else "",
    )
    return "\n".join(text for text in texts if text).casefold()
