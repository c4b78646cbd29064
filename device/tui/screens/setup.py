"""Set-up: a list of actions on the left, and on the right the panel of the chosen one."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial
from typing import ClassVar, Final

from textual.binding import Binding, BindingType
from textual.containers import Horizontal, VerticalScroll
from textual.widget import Widget

from device.bundles.check import UNITS, CheckStandard, StandardKind
from device.errors import DeviceError
from device.instrument.instrument import Instrument
from device.instrument.pairing_run import NetworkInfo
from device.instrument.state import InstrumentState
from device.store.choices import make_gel
from device.store.registry import RegisteredCalibration
from device.store.transfers import StickExport
from device.tui.drawing.cells import ColourDepth
from device.tui.drawing.text import local_time
from device.tui.screens.base import InstrumentScreen
from device.tui.screens.machine_actions import SETUP_ACTIONS, MachineActions, SetupAction
from device.tui.screens.panels import (
    check_panel,
    exposure_panel,
    focus_panel,
    instrument_panel,
    pairing_panel,
    selftest_panel,
)
from device.tui.widgets.dialogs import ChoiceDialog, ChoiceList, ConfirmDialog, FieldsDialog
from device.tui.widgets.navigation import Notice, Words

STANDARD_HINT: Final = "As on its certificate; the same unit for both"
MAX_STANDARD_UM: Final = 1e5

GEL_HINT: Final = "Lower-case letters, digits and hyphens, for example the number on the gel's frame"


class SetUpScreen(InstrumentScreen):
    """Rarely needed actions."""

    PLACE = "set-up"
    AUTO_FOCUS = "#actions"
    BINDINGS: ClassVar[list[BindingType]] = [Binding("x", "stop", "stop")]

    def __init__(self, instrument: Instrument, _depth: ColourDepth) -> None:
        super().__init__(instrument)
        self._actions_list = ChoiceList([action.title for action in SETUP_ACTIONS], id="actions")
        self._panel = Words(id="panel", markup=False)
        self._network: NetworkInfo | None = None
        self._machine = MachineActions(self)

    def body(self) -> Iterable[Widget]:
        """Return the list and the panel."""
        with Horizontal(id="set-up"):
            yield self._actions_list
            with VerticalScroll(id="panel-side", can_focus=False):
                yield self._panel

    def show_body(self, state: InstrumentState) -> None:
        """Update the panel of the chosen action."""
        self._panel.update(self._text(state))
        self.refresh_bindings()

    def on_screen_resume(self) -> None:
        """Read network, Wi-Fi, clock and brightness again: cables may have been plugged meanwhile."""
        self.work(self.instrument.network, self._show_network)
        self._machine.refresh()
        self._read_levels()

    def on_screen_suspend(self) -> None:
        """Read focus and light no longer: nobody sees them."""
        self.instrument.read_focus(False)
        self.instrument.read_levels(False)

    def on_line_list_chosen(self) -> None:
        """Show the panel of the chosen action."""
        if self._chosen().name != "focus":
            self.instrument.read_focus(False)
        self._read_levels()
        self.show_body(self.instrument.state)

    def _read_levels(self) -> None:
        """Read the light on the skin while its panel is shown."""
        self.instrument.read_levels(self._chosen().name == "exposure")

    async def on_choice_list_done(self) -> None:
        """Start the chosen action."""
        match self._chosen().name:
            case "pair":
                self.instrument.open_pairing()
            case "test" if self.instrument.state.activity in {"calibrating", "balancing"}:
                question = "Stop and test all parts? The calibration that was active before stays so."
                self.ask(ConfirmDialog(question, "Stop and test"), lambda _: self._selftest())
            case "test":
                self._selftest()
            case "focus":
                self.instrument.read_focus(self.instrument.state.focus is None)
            case "exposure":
                self._balance()
            case "zero":
                self.instrument.zero_check()
            case "check":
                self._check()
            case "gel":
                self.work(self._known_gels, self._ask_for_gel)
            case "calibrations":
                self.work(self.instrument.calibrations, self._ask_for_calibration)
            case "stick":
                self.retroscan.notice = Notice("Copying to the USB stick ...")
                self.work(self.instrument.export_to_stick, self._show_export)
            case "display":
                self.retroscan.switch_display()
            case "brightness" | "clock" | "wifi" as name:
                self._machine.start(name)
            case "off":
                question = "Power off? Running work is stored first."
                self.ask(ConfirmDialog(question, "Power off"), lambda _: self.instrument.power_off())
            case _:
                await self.retroscan.go("scan")

    def _selftest(self) -> None:
        self.retroscan.findings.clear()
        self.instrument.run_selftest()

    async def short_push(self) -> None:
        """Choose the next action; after the last one the first."""
        self._actions_list.choose_next()

    async def long_push(self) -> bool:
        """Start the chosen action."""
        await self.on_choice_list_done()
        return True

    def _chosen(self) -> SetupAction:
        return SETUP_ACTIONS[self._actions_list.chosen or 0]

    def _text(self, state: InstrumentState) -> str:
        columns, chosen = self._panel.size.width, self._chosen()
        running, findings = state.activity == "self-test", self.retroscan.findings
        if chosen.name == "pair" and state.pairing:
            return pairing_panel(state.pairing, self._network, self.retroscan.now_ns(), columns)
        if chosen.name == "test" and (findings or running):
            return selftest_panel(findings, running, columns)
        if chosen.name == "check":
            return check_panel(state.check, columns)
        if chosen.name == "exposure":
            return exposure_panel(state, columns)
        if chosen.name == "focus" and state.focus:
            return focus_panel(state.focus, columns)
        now = self.instrument.wall_time()
        if chosen.name in {"brightness", "clock", "wifi"}:
            return self._machine.panel(chosen.name, chosen.meaning, now, columns)
        return chosen.meaning or instrument_panel(state, self.retroscan.program, self._network, columns, now)

    def _show_export(self, outcome: StickExport) -> None:
        self.retroscan.notice = Notice(outcome.sentence, "error" if outcome.failed else "success")

    def _show_network(self, network: NetworkInfo) -> None:
        self._network = network
        self.show_body(self.instrument.state)

    def action_stop(self) -> None:
        """Stop the exposure balance."""
        self.instrument.cancel_run()

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Only an exposure balance can be stopped here."""
        if action == "stop":
            return self.instrument.state.activity == "balancing"
        return super().check_action(action, parameters)

    def _balance(self) -> None:
        """Start the exposure balance, take its next press, or take the profile's exposure again."""
        if self.instrument.state.activity == "balancing":
            self.instrument.press()
            return
        lines = ["Balance now: three ball presses"]
        light = self.instrument.state.next_light
        if light and light.is_balanced:
            lines.append("Board profile's exposure again")
        self.ask(ChoiceDialog("Exposure of the next calibration", lines), self._start_balance)

    def _start_balance(self, chosen: int) -> None:
        if chosen == 0:
            self.instrument.start_balance()
        elif chosen == 1:
            self.instrument.forget_balance()

    def _check(self) -> None:
        """Check now, or enter another check standard."""
        standard = self.instrument.state.check.standard
        if standard is None:
            self._ask_for_standard(1)
            return
        now = "Do not check" if self.instrument.state.check.is_next else f"Press {standard.name} now"
        self.ask(ChoiceDialog("Check standard", [now, "Enter another standard"]), self._ask_for_standard)

    def _ask_for_standard(self, chosen: int) -> None:
        if chosen == 0:
            self.instrument.begin_check()
            self.app.call_later(self.retroscan.go, "scan")
        elif chosen == 1:
            kinds = [f"{kind}, {unit}" for kind, (unit, _) in UNITS.items()]
            self.ask(ChoiceDialog("What is certified?", kinds), self._ask_for_value)

    def _ask_for_value(self, chosen: int) -> None:
        kind = tuple(UNITS)[chosen]
        what = {"ball": "Radius", "step": "Height", "roughness": "Ra"}[kind]
        fields = {"Name": kind, f"{what}, {UNITS[kind][0]}": "", "±": ""}
        dialog = FieldsDialog("Check standard", fields, STANDARD_HINT, lambda texts: _standard_complaint(kind, texts))
        self.ask(dialog, lambda texts: self.instrument.set_standard(_standard(kind, texts)))

    def _known_gels(self) -> list[str]:
        """Return gels that were mounted here, or have a calibration here."""
        mounted = {self.instrument.state.gel.gel_id} | {gel.gel_id for gel in self.instrument.gels()}
        return sorted(mounted | {known.bundle.record.gel_id for known in self.instrument.calibrations()})

    def _ask_for_gel(self, gels: Sequence[str]) -> None:
        chosen = gels.index(self.instrument.state.gel.gel_id)
        dialog = ChoiceDialog("Which gel is mounted?", [*gels, "another gel"], chosen)
        self.ask(dialog, partial(self._change_gel, gels))

    def _change_gel(self, gels: Sequence[str], chosen: int) -> None:
        if chosen < len(gels):
            self.instrument.change_gel(gels[chosen])
            return
        thickness = f"{self.instrument.state.gel.slab_thickness_mm:g}"
        fields = {"Name": "", "Slab, mm": thickness}
        dialog = FieldsDialog("New gel", fields, GEL_HINT, _gel_complaint)
        self.ask(dialog, lambda texts: self.instrument.change_gel(texts["Name"], _thickness_mm(texts)))

    def _ask_for_calibration(self, calibrations: Sequence[RegisteredCalibration]) -> None:
        if not calibrations:
            self.retroscan.report_failure("No calibration yet: open Calibrate (key 2)")
            return
        lines = [_calibration_line(each) for each in calibrations]
        active = [index for index, each in enumerate(calibrations) if each.active]
        dialog = ChoiceDialog("Which calibration should be active?", lines, active[0] if active else 0)
        self.ask(dialog, partial(self._activate, calibrations))

    def _activate(self, calibrations: Sequence[RegisteredCalibration], chosen: int) -> None:
        if not calibrations[chosen].active:
            self.instrument.activate(calibrations[chosen].bundle.calibration_id)


def _standard(kind: StandardKind, fields: dict[str, str]) -> CheckStandard:
    name, value, tolerance = fields.values()
    factor = UNITS[kind][1]
    value_um, tolerance_um = (factor * float(text.replace(",", ".")) for text in (value, tolerance))
    return CheckStandard(name=name or kind, kind=kind, value_um=value_um, tolerance_um=tolerance_um)


def _standard_complaint(kind: StandardKind, fields: dict[str, str]) -> str:
    """Return what is wrong with a check standard's figures; empty if nothing is."""
    try:
        standard = _standard(kind, fields)
    except ValueError:
        return f"write numbers, for example 3 and 0.002, in {UNITS[kind][0]}"
    if not 0.0 < standard.value_um <= MAX_STANDARD_UM or not 0.0 <= standard.tolerance_um < standard.value_um:
        return "the value must be above 0 and its ± smaller than it"
    return ""


def _thickness_mm(fields: dict[str, str]) -> float:
    return float(fields["Slab, mm"].replace(",", "."))


def _gel_complaint(fields: dict[str, str]) -> str:
    """Return what is wrong with a new gel's name or thickness; empty if nothing is."""
    try:
        make_gel(fields["Name"], _thickness_mm(fields))
    except ValueError as error:
        is_number = isinstance(error, DeviceError)
        return str(error) if is_number else f"{fields['Slab, mm']!r} is not a thickness in mm"
    return ""


def _calibration_line(calibration: RegisteredCalibration) -> str:
    """Gel, slot, version and time of a calibration, and whether it is active."""
    record, entry = calibration.bundle.record, calibration.entry
    mark = " active" if calibration.active else ""
    return f"{record.gel_id} {entry.slot} v{entry.version} {local_time(record.created)}{mark}"
