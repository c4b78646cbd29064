"""Set-up: a list of errands on the left, and on the right the sheet that belongs to the chosen one."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import TypeVar

from textual.containers import Horizontal, VerticalScroll
from textual.widget import Widget
from textual.widgets import Static

from device.calibration_shelf import Shelved
from device.errors import DeviceError
from device.session.instrument import Instrument
from device.session.network import NetworkFacts
from device.session.state import InstrumentState
from device.tui.dialogs import ChoiceDialog, ConfirmDialog, FieldsDialog
from device.tui.errands import ERRANDS, Errand
from device.tui.instrument_screen import InstrumentScreen
from device.tui.line_list import ChoiceList
from device.tui.sheets import instrument_sheet, pairing_sheet, selftest_sheet
from device.tui.terminal import ColourDepth

Read = TypeVar("Read")


class SetUpScreen(InstrumentScreen):
    """What is done once in a while."""

    PLACE = "set-up"
    AUTO_FOCUS = "#errands"

    def __init__(self, instrument: Instrument, _depth: ColourDepth) -> None:
        super().__init__(instrument)
        self._errands = ChoiceList([errand.title for errand in ERRANDS], id="errands")
        self._sheet = Static(id="sheet", markup=False)
        self._network: NetworkFacts | None = None

    def body(self) -> Iterable[Widget]:
        """The list and the sheet."""
        with Horizontal(id="set-up"):
            yield self._errands
            with VerticalScroll(id="sheet-side", can_focus=False):
                yield self._sheet

    def follow(self, state: InstrumentState) -> None:
        """The sheet of what is chosen."""
        self._sheet.update(self._text(state))

    def on_screen_resume(self) -> None:
        """Come back: cables may have been plugged meanwhile."""
        self._read(self.instrument.network, self._show_network)

    def on_line_list_chosen(self) -> None:
        """Show the sheet of the chosen errand."""
        self.follow(self.instrument.state)

    async def on_choice_list_done(self) -> None:
        """Do what is chosen."""
        match self._chosen().name:
            case "pair":
                self.instrument.open_pairing()
            case "test":
                self.retroscan.findings.clear()
                self.instrument.run_selftest()
            case "zero":
                self.instrument.zero_check()
            case "gel":
                self._read(self._known_gels, self._ask_for_gel)
            case "calibrations":
                self._read(self.instrument.calibrations, self._ask_for_calibration)
            case "off":
                question = "Power off? Scans that are still in work are stored first."
                self.app.push_screen(ConfirmDialog(question, "Power off"), self._power_off)
            case _:
                await self.retroscan.go("scan")

    async def short_push(self) -> None:
        """The next errand; after the last, the first."""
        self._errands.choose_next()

    async def long_push(self) -> bool:
        """Do it."""
        await self.on_choice_list_done()
        return True

    def _chosen(self) -> Errand:
        return ERRANDS[self._errands.chosen or 0]

    def _text(self, state: InstrumentState) -> str:
        columns, chosen = self._sheet.size.width, self._chosen()
        running, findings = state.activity == "self-test", self.retroscan.findings
        if chosen.name == "pair" and state.pairing:
            return pairing_sheet(state.pairing, self._network, self.retroscan.now_ns(), columns)
        if chosen.name == "test" and (findings or running):
            return selftest_sheet(findings, running, columns)
        return chosen.meaning or instrument_sheet(state, self.retroscan.program, self._network, columns)

    def _read(self, read: Callable[[], Read], show: Callable[[Read], None]) -> None:
        """Read on another thread, as a slow disk must not stop the screens."""
        self.run_worker(partial(self._read_then, read, show), thread=True)

    def _read_then(self, read: Callable[[], Read], show: Callable[[Read], None]) -> None:
        try:
            what = read()
        except DeviceError as error:
            self.app.call_from_thread(self.retroscan.tell_failure, str(error))
            return
        self.app.call_from_thread(show, what)

    def _show_network(self, network: NetworkFacts) -> None:
        self._network = network
        self.follow(self.instrument.state)

    def _known_gels(self) -> list[str]:
        """Gels that were mounted here, or have a calibration here."""
        mounted = {self.instrument.state.gel.gel_id} | {gel.gel_id for gel in self.instrument.gels()}
        return sorted(mounted | {shelved.bundle.record.gel_id for shelved in self.instrument.calibrations()})

    def _ask_for_gel(self, gels: Sequence[str]) -> None:
        chosen = gels.index(self.instrument.state.gel.gel_id)
        dialog = ChoiceDialog("Which gel is mounted?", [*gels, "another one"], chosen)
        self.app.push_screen(dialog, partial(self._change_gel, gels))

    def _change_gel(self, gels: Sequence[str], chosen: int | None) -> None:
        if chosen is None:
            return
        if chosen < len(gels):
            self.instrument.change_gel(gels[chosen])
            return
        thickness = f"{self.instrument.state.gel.slab_thickness_mm:g}"
        fields = {"Name": "", "Slab, mm": thickness}
        hint = "Any name that tells it from the others, such as the number on its frame"
        self.app.push_screen(FieldsDialog("A gel that is new here", fields, hint), self._new_gel)

    def _new_gel(self, fields: dict[str, str] | None) -> None:
        if fields is None:
            return
        try:
            slab_thickness_mm = float(fields["Slab, mm"].replace(",", "."))
        except ValueError:
            self.retroscan.tell_failure(f"{fields['Slab, mm']!r} is no thickness in mm: change the gel again")
            return
        self.instrument.change_gel(fields["Name"], slab_thickness_mm)

    def _ask_for_calibration(self, shelved: Sequence[Shelved]) -> None:
        if not shelved:
            self.retroscan.tell_failure("There is no calibration yet: open Calibrate (key 2)")
            return
        lines = [_shelf_line(each) for each in shelved]
        places = [place for place, each in enumerate(shelved) if each.in_force]
        dialog = ChoiceDialog("Which calibration is to be in force?", lines, places[0] if places else 0)
        self.app.push_screen(dialog, partial(self._put_in_force, shelved))

    def _put_in_force(self, shelved: Sequence[Shelved], chosen: int | None) -> None:
        if chosen is not None and not shelved[chosen].in_force:
            self.instrument.put_in_force(shelved[chosen].bundle.calibration_id)

    def _power_off(self, yes: bool | None) -> None:
        if yes:
            self.instrument.power_off()


def _shelf_line(shelved: Shelved) -> str:
    """One calibration in a line: gel, version, when, and whether it is in force."""
    record = shelved.bundle.record
    now = " in force" if shelved.in_force else ""
    return f"{record.gel_id} {shelved.entry.slot} v{shelved.entry.version} {record.created:%Y-%m-%d %H:%M}{now}"
