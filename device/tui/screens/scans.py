"""Scans: the history, the quick look of the chosen scan, its mark and note."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from functools import partial
from typing import ClassVar, Final, Literal

import numpy as np
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical
from textual.widget import Widget

from device.bundles.scan import MovieRecord
from device.errors import DeviceError
from device.instrument.history import History, ScanEntry
from device.instrument.instrument import Instrument
from device.instrument.state import InstrumentState
from device.store.choices import Opinion
from device.surface import Float64Array, HeightMap
from device.tui.drawing.cells import ColourDepth
from device.tui.drawing.relief import EIGHTHS, HALVES
from device.tui.drawing.text import local_time, screen_advice, sticky_text
from device.tui.screens.base import SPOT_LEFT, InstrumentScreen
from device.tui.widgets.cells_view import HeightView
from device.tui.widgets.dialogs import FieldsDialog, LineList
from device.tui.widgets.navigation import Notice, Words

FIND_HINT = "For example: lid doubtful, #12, unsent, marked bad, 2026-11; nothing: all scans"
HEADING = "     # verdict  mark sent part"


class ScansScreen(InstrumentScreen):
    """The stored scans."""

    PLACE = "scans"
    AUTO_FOCUS = "#history"
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("g", "mark('good')", "good"),
        Binding("b", "mark('bad')", "bad"),
        Binding("u", "mark('')", "unmark", show=False),
        Binding("p", "profile", "profile"),
        Binding("x,delete", "delete", "delete", key_display="x"),
        Binding("w", "way_back", "spot", tooltip="way back to this scan's spot"),
        Binding("n", "note", "note"),
        Binding("z", "undo", "undo"),
        Binding("slash", "find", "find", key_display="/"),
        Binding("s", "sort", "sort"),
        Binding("v", "view", "relief in pixels", show=False),
    ]

    def __init__(self, instrument: Instrument, depth: ColourDepth) -> None:
        super().__init__(instrument)
        self._depth = depth
        self._list = LineList(id="history")
        self._relief = HeightView(depth, below=6)
        self._words = Words(id="words", markup=False)
        self._history = History((), ())
        self._heading = Words(HEADING, id="history-heading", markup=False)
        self._words_wanted = ""
        self._order: Order = ORDERS[0]
        self._scans: tuple[ScanEntry, ...] = ()
        self._known: tuple[object, ...] | None = None
        self._shown: str | None = None

    def body(self) -> Iterable[Widget]:
        """Return the list on the left; relief and details on the right."""
        with Horizontal(id="review"):
            with Vertical(id="history-side"):
                yield self._heading
                yield self._list
            with Vertical(id="scan-side"):
                yield self._relief
                yield self._words

    def show_body(self, state: InstrumentState) -> None:
        """Read the history again after another scan."""
        known = (state.scans_stored, state.last and state.last.scan_id)
        if known != self._known:
            self._known = known
            self.reread()

    def on_screen_resume(self) -> None:
        """Read the history again: scans may have been offloaded meanwhile."""
        self.reread()

    def reread(self) -> None:
        """Read the history on another thread."""
        self.work(self.instrument.history, self._show_history, "history", exclusive=True)

    def action_mark(self, opinion: str) -> None:
        """Mark the chosen scan good or bad, or remove the mark."""
        if entry := self._entry():
            note = entry.mark.note if entry.mark else ""
            self._write(entry, "good" if opinion == "good" else "bad" if opinion == "bad" else None, note)

    def action_note(self) -> None:
        """Edit the chosen scan's note."""
        if entry := self._entry():
            opinion, note = (entry.mark.opinion, entry.mark.note) if entry.mark else (None, "")
            dialog = FieldsDialog(f"Scan #{entry.counter}", {"Note": note}, "Enter: save · Escape: cancel")
            self.ask(dialog, lambda fields: self._write(entry, opinion, fields["Note"]))

    def action_delete(self) -> None:
        """Delete the chosen scan; undo brings it back until power off."""
        if entry := self._entry():
            sentence = f"Scan #{entry.counter} is deleted: z brings it back until power off."
            self._change(partial(self.instrument.delete, entry.scan_id), sentence)

    def action_undo(self) -> None:
        """Bring the scan that was deleted last back."""
        self._change(self.instrument.undo_delete, "The scan is back.")

    def action_way_back(self) -> None:
        """Find the chosen scan's spot again: pushes on Scan say the way to it; the same scan again ends that."""
        if not (entry := self._entry()):
            return
        spot = self.instrument.state.spot
        if spot and spot.scan_id == entry.scan_id:
            self.instrument.end_guiding()
            self.retroscan.notice = Notice(SPOT_LEFT)
        else:
            find = partial(self.instrument.find_spot, entry.scan_id, entry.counter)
            self.work(find, lambda _: self.app.call_later(self.retroscan.go, "scan"), "spot", exclusive=True)

    def action_find(self) -> None:
        """Show only scans with certain words."""
        dialog = FieldsDialog("Which scans?", {"Words": self._words_wanted}, FIND_HINT)
        self.ask(dialog, self._find)

    def action_sort(self) -> None:
        """Show the scans in the next order."""
        self._order = ORDERS[(ORDERS.index(self._order) + 1) % len(ORDERS)]
        self.retroscan.notice = Notice(f"Sorted {self._order}.")
        self._list_scans()

    def _find(self, fields: dict[str, str]) -> None:
        self._words_wanted = fields["Words"]
        self._list_scans()

    def _change(self, work: Callable[[], object], sentence: str) -> None:
        self.work(work, lambda _: self._changed(sentence), "change")

    def _changed(self, sentence: str) -> None:
        self.retroscan.notice = Notice(sentence)
        self.reread()

    def action_profile(self) -> None:
        """Show or hide the profile."""
        if self._relief.check_action("profile", ()):
            self._relief.action_profile()

    def action_view(self) -> None:
        """Show the relief in pixels, if the terminal can."""
        self._relief.action_view()

    def on_height_view_profile_switched(self, event: HeightView.ProfileSwitched) -> None:
        """Give the arrow keys to the profile's cursor while it is shown, otherwise to the list."""
        self.set_focus(self._relief if event.is_shown else self._list)

    async def short_push(self) -> None:
        """Choose the next older scan; after the oldest the newest."""
        self._list.choose_next()

    def on_line_list_chosen(self, event: LineList.Chosen) -> None:
        """Show the chosen scan."""
        self._show(event.index)

    def _entry(self) -> ScanEntry | None:
        chosen = self._list.chosen
        return self._scans[chosen] if chosen is not None and chosen < len(self._scans) else None

    def _show_history(self, history: History) -> None:
        self._history = history
        self._list_scans()
        if history.damaged:
            self.retroscan.report_failure(history.damaged[0])

    def _list_scans(self) -> None:
        """Show the wanted scans in the wanted order, and keep the chosen one."""
        chosen, before = self._entry(), self._list.chosen or 0
        self._scans = chosen_scans(self._history.scans, self._words_wanted, self._order)
        what = f"{len(self._scans)} with {self._words_wanted!r}" if self._words_wanted else HEADING
        self._heading.update(what)
        ids = [entry.scan_id for entry in self._scans]
        place = ids.index(chosen.scan_id) if chosen and chosen.scan_id in ids else before
        self._list.show([scan_line(entry) for entry in self._scans], place)
        if not self._scans:
            self._shown = None
            self._relief.show(None, "No such scan: / takes other words." if self._history.scans else "No scans yet.")
            self._words.update("\n".join(self._history.damaged))

    def _show(self, index: int) -> None:
        if index >= len(self._scans):
            return
        entry = self._scans[index]
        self._words.update(details_of(entry, self._depth))
        if entry.scan_id != self._shown:
            self._shown = entry.scan_id
            self.run_worker(partial(self._read_quick_look, entry.scan_id), thread=True, group="look", exclusive=True)

    def _read_quick_look(self, scan_id: str) -> None:
        try:
            height = self.instrument.quick_look(scan_id)
            sentence = "This scan has no quick look: offload it and reconstruct it."
        except DeviceError as error:
            height, sentence = None, str(error)
        self.app.call_from_thread(self._show_quick_look, scan_id, height, sentence)

    def _show_quick_look(self, scan_id: str, height: HeightMap | None, sentence: str) -> None:
        if scan_id == self._shown:
            self._relief.show(height, screen_advice(sentence))

    def _write(self, entry: ScanEntry, opinion: Opinion | None, note: str) -> None:
        self.work(partial(self.instrument.mark, entry.scan_id, opinion, note), lambda _: self.reread(), "mark")


# The history in lines: what a scan's line and details say, and which scans are shown in which order.

BARS: Final = 7
"""Bars of either, so that both fit in a line beside the history on a screen of 80 columns."""


def movie_text(movie: MovieRecord, depth: ColourDepth) -> str:
    """Return contact and depth over the press in one line, with the largest value of each.

    A frame without a value has no bar.
    """
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
    """Return verdict, annotations, time, offload state, note and movie of a scan as lines of text."""
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
