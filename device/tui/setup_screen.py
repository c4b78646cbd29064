"""Set-up: a list of things to do on the left, and on the right the sheet that belongs to the chosen one."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final, Literal

from textual.containers import Horizontal, VerticalScroll
from textual.widget import Widget
from textual.widgets import Static

from device.session.instrument import Instrument
from device.session.state import InstrumentState
from device.tui.dialogs import ConfirmDialog
from device.tui.instrument_screen import InstrumentScreen
from device.tui.line_list import ChoiceList
from device.tui.sheets import MachineFacts, instrument_sheet, pairing_sheet, selftest_sheet
from device.tui.terminal import ColourDepth

Errand = Literal["back", "facts", "pair", "test", "off"]

ERRANDS: Final[tuple[tuple[Errand, str], ...]] = (
    ("back", "Back to Scan"),
    ("facts", "This instrument"),
    ("pair", "Pair a workstation"),
    ("test", "Self-test"),
    ("off", "Power off"),
)


class SetUpScreen(InstrumentScreen):
    """What is done once in a while."""

    PLACE = "set-up"
    AUTO_FOCUS = "#errands"

    def __init__(self, instrument: Instrument, depth: ColourDepth) -> None:
        super().__init__(instrument, depth)
        self._errands = ChoiceList([title for _, title in ERRANDS], id="errands")
        self._sheet = Static(id="sheet", markup=False)

    def body(self) -> Iterable[Widget]:
        """The list and the sheet."""
        with Horizontal(id="set-up"):
            yield self._errands
            with VerticalScroll(id="sheet-side", can_focus=False):
                yield self._sheet

    def follow(self, state: InstrumentState) -> None:
        """The sheet of what is chosen."""
        self._sheet.update(self._text(state))

    def on_line_list_chosen(self) -> None:
        """Show the sheet of the chosen errand."""
        self.follow(self.instrument.state)

    async def on_choice_list_done(self) -> None:
        """Do what is chosen."""
        match self._chosen():
            case "test":
                self.retroscan.findings.clear()
                self.instrument.run_selftest()
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
        return ERRANDS[self._errands.chosen or 0][0]

    def _power_off(self, yes: bool | None) -> None:
        if yes:
            self.instrument.power_off()

    def _text(self, state: InstrumentState) -> str:
        machine: MachineFacts = self.retroscan.machine
        columns = self._sheet.size.width
        match self._chosen():
            case "pair":
                return pairing_sheet(state.pairing, machine, self.retroscan.now_ns(), columns)
            case "test":
                return selftest_sheet(self.retroscan.findings, state.activity == "self-test", columns)
            case "off":
                return "Stores what is in work, darkens the lights and switches the instrument off."
            case _:
                return instrument_sheet(state, machine, columns)
