"""Scan: the live picture and the press guide on the left, the last scan with its verdict on the right."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from typing import ClassVar, Final

from msgspec import structs
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical
from textual.content import Content
from textual.widget import Widget

from device.bundles.scan import Annotations, CaptureMode
from device.errors import DeviceError
from device.guidance.cover_task import MAX_AREA_MM
from device.guidance.guide import Advice
from device.instrument.health import NO_ROOM
from device.instrument.instrument import Instrument
from device.instrument.state import Activity, AreaState, InstrumentState, LastScan, SpotState
from device.tui.drawing.cells import ColourDepth
from device.tui.drawing.text import gauge_text, screen_advice, sticky_text, verdict_word
from device.tui.screens.base import AREA_LEFT, SPOT_LEFT, InstrumentScreen
from device.tui.widgets.cells_view import HeightView, LiveView
from device.tui.widgets.dialogs import ChoiceDialog, FieldsDialog
from device.tui.widgets.navigation import Notice, Words

_VERDICT_STYLE = {"good": "$success bold", "doubtful": "$warning bold", "retake": "$error bold"}

_MODES: Final[tuple[CaptureMode, ...]] = ("single", "average", "lights", "movie")
_MODE_WORDS: Final[dict[CaptureMode, str]] = {
    "single": "",
    "average": " · precise",
    "lights": " · precise, each light",
    "movie": " · movie",
}


AREA_HINT: Final = f"At most {MAX_AREA_MM:.0f} mm each way. Enter: next field · Escape: cancel"

TOUCHES: Final[dict[Advice, str]] = {
    "press": "Touch the object lightly.",
    "press more": "Hold still and push the button: a light touch is enough.",
}
"""Advice while the way back to a spot is looked for, in place of that for a scan."""

_ELSEWHERE: Final[dict[Activity, str]] = {
    "calibrating": "A calibration is under way: key 2 shows it.",
    "balancing": "The exposure is being balanced: key 4 shows it.",
}
"""What uses the presses while no scan is taken."""


class ScanScreen(InstrumentScreen):
    """The main screen."""

    PLACE = "scan"
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape", "leave", "leave", key_display="Esc"),
        Binding("space", "scan", "scan"),
        Binding("j", "sticky", "job"),
        Binding("o", "presets", "presets of job, part and operator", show=False),
        Binding("i", "number", "number parts, or no longer", show=False),
        Binding("r", "retake", "retake"),
        Binding("b", "code", "part's name by QR code or barcode", show=False),
        Binding("a", "auto", "auto"),
        Binding("w", "area", "area", tooltip="cover an area larger than the field"),
        Binding("m", "mode", "one frame, precise, each light, or a movie", show=False),
        Binding("z", "zero", "zero"),
        Binding("d", "demonstrate", "press"),
    ]

    def __init__(self, instrument: Instrument, depth: ColourDepth) -> None:
        super().__init__(instrument)
        self._live = LiveView(depth, below=4)
        self._gauges = Words(id="gauges", markup=False)
        self._relief = HeightView(depth, below=4)
        self._verdict = Words(id="verdict", markup=False)
        self._cue = Words(id="cue", markup=False)
        self._area_mm = {"Width, mm": "", "Height, mm": ""}
        self._map = Words(id="area-map", markup=False)
        self._sticky = Words(id="sticky", markup=False)

    def body(self) -> Iterable[Widget]:
        """Return the live picture and gauges; quick look and verdict; cue; annotations."""
        with Horizontal(id="pictures"):
            with Vertical(id="live-side"):
                yield self._live
                yield self._gauges
            with Vertical(id="scan-side"):
                yield self._relief
                yield self._map
                yield self._verdict
        yield self._cue
        yield self._sticky

    def show_body(self, state: InstrumentState) -> None:
        """Update last scan, cue and annotations."""
        self._cue.update(cue_text(state))
        self._cue.set_class(_is_ready(state), "-ready")
        auto = " · auto-shutter on" if state.auto_shutter else ""
        following = ""  # stands first: a narrow screen cuts the end
        if state.check.is_next and state.check.standard:
            following = f"next: check of {state.check.standard.name} · "
        elif state.spot:
            following = f"finding #{state.spot.counter}, nothing is stored · "
        elif state.area:
            following = f"area of {state.area.width_mm:g} x {state.area.height_mm:g} mm · "
        elif state.replaces:
            following = f"next: retake of #{state.replaces.counter} · "
        numbered = " (numbered)" if state.settings.number_parts else ""
        mode = _MODE_WORDS[state.settings.capture]
        self._sticky.update(f"{following}{sticky_text(state.sticky, numbered)}{mode}{auto}")
        self._show_last(state)
        self.refresh_bindings()

    def show_live(self, state: InstrumentState) -> None:
        """Show live picture and gauges."""
        if state.live is None:
            self._live.show(None, sentence=idle_sentence(state))
            self._gauges.update("")
            return
        reading = state.live.reading
        self._live.show(state.live.picture)
        width = self._gauges.size.width
        gauges = {"contact": reading.contact_fraction, "exposure": reading.exposure, "depth": reading.depth_fraction}
        self._gauges.update("\n".join(gauge_text(name, fraction, width) for name, fraction in gauges.items()))

    def action_scan(self) -> None:
        """Scan, like a push of the button."""
        self.instrument.press()

    def action_leave(self) -> None:
        """End the search for a spot, or the area: pushes scan as usual."""
        self.retroscan.notice = Notice(SPOT_LEFT if self.instrument.state.spot else AREA_LEFT)
        self.instrument.end_guiding()

    def action_area(self) -> None:
        """Ask for an area's size and cover it scan by scan; while one is covered, leave it."""
        if self.instrument.state.area:
            self.action_leave()
            return
        dialog = FieldsDialog("Cover an area", self._area_mm, AREA_HINT, area_complaint, replaces=True)
        self.ask(dialog, self._cover_area)

    def _cover_area(self, fields: dict[str, str]) -> None:
        self._area_mm = fields
        width_mm, height_mm = (float(text) for text in fields.values())
        self.instrument.cover_area(width_mm, height_mm)

    def action_auto(self) -> None:
        """Toggle the auto-shutter."""
        self.instrument.set_auto_shutter(not self.instrument.state.auto_shutter)
        self.show_body(self.instrument.state)

    def action_mode(self) -> None:
        """Take presses with one frame, the average of several, or that and each light alone."""
        settings = self.instrument.state.settings
        following = _MODES[(_MODES.index(settings.capture) + 1) % len(_MODES)]
        self.instrument.set_settings(structs.replace(settings, capture=following))
        if self.instrument.state.settings.capture != following:  # this sensor cannot do it, as the message says
            self.instrument.set_settings(structs.replace(settings, capture=_MODES[0]))
        self.show_body(self.instrument.state)

    def action_zero(self) -> None:
        """Run the zero check."""
        self.instrument.zero_check()

    def action_code(self) -> None:
        """Name the part by the code before the camera."""
        self.instrument.read_code()

    def action_retake(self) -> None:
        """Let the next scan replace the last one."""
        self.instrument.retake()
        self.show_body(self.instrument.state)

    def action_number(self) -> None:
        """Give each scan's part the next number, or no longer."""
        settings = self.instrument.state.settings
        self.instrument.set_settings(structs.replace(settings, number_parts=not settings.number_parts))
        self.show_body(self.instrument.state)

    def action_presets(self) -> None:
        """Choose job, part and operator from those that were stored, or store the present ones."""
        presets, present = self.instrument.presets(), self.instrument.state.sticky
        lines = [f"Store: {sticky_text(present)}", *(sticky_text(preset) for preset in presets)]
        dialog = ChoiceDialog("Job, part and operator", lines, 1 if presets else 0)
        self.ask(dialog, partial(self._choose_preset, presets))

    def _choose_preset(self, presets: tuple[Annotations, ...], chosen: int) -> None:
        sticky = self.instrument.state.sticky
        if chosen:
            self.instrument.set_sticky(structs.replace(presets[chosen - 1], note=sticky.note))
            self.show_body(self.instrument.state)
            return
        try:
            self.instrument.add_preset(structs.replace(sticky, note=None))
        except DeviceError as error:
            self.retroscan.report_failure(str(error))
        else:
            self.retroscan.notice = Notice("Stored: o lists it.")

    def action_demonstrate(self) -> None:
        """Let the twin's operator press the next object."""
        self.retroscan.demonstrate()

    def action_sticky(self) -> None:
        """Edit job, part and operator."""
        sticky = self.instrument.state.sticky
        fields = {"Job": sticky.job or "", "Part": sticky.part or "", "Operator": sticky.operator or ""}
        dialog = FieldsDialog("Stored with every scan from now on", fields, "Enter: next field · Escape: cancel")
        self.ask(dialog, self._save_sticky)

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Only the twin can press objects, and only a mode can be left."""
        if action == "leave":
            state = self.instrument.state
            return state.spot is not None or state.area is not None
        return self.retroscan.is_twin if action == "demonstrate" else super().check_action(action, parameters)

    def _save_sticky(self, fields: dict[str, str]) -> None:
        note = self.instrument.state.sticky.note
        job, part, operator = (fields[name] or None for name in ("Job", "Part", "Operator"))
        self.instrument.set_sticky(Annotations(job=job, part=part, operator=operator, note=note))
        self.show_body(self.instrument.state)

    def _show_last(self, state: InstrumentState) -> None:
        self._relief.display, self._map.display = state.area is None, state.area is not None
        if self._relief.display and self.focused is None:
            self._relief.focus()  # a map of an area took it, and with it the keys of the profile
        if area := state.area:
            columns, rows = self._map.size
            lines = area.map.lines(columns, rows) if area.map and columns and rows else []
            self._map.update("\n".join(lines))
            self._verdict.update(area_text(area, state.last if area.map else None))
            return
        if spot := state.spot:
            self._relief.show(spot.height, "")
            self._verdict.update(spot_text(spot))
            return
        last = state.last
        if last is None:
            self._relief.show(None, screen_advice(state.calibration.fault) or "The relief of a scan appears here.")
            self._verdict.update("")
            return
        self._relief.show(last.height, last.fault and f"No quick look: {screen_advice(last.fault)}")
        self._verdict.update(verdict_text(last))


def verdict_text(last: LastScan) -> Content:
    """Return the number, level and reason of a scan."""
    level = last.verdict.level
    return Content.assemble(
        (f"{verdict_word(level)} ", _VERDICT_STYLE[level]),
        (f"#{last.counter} ", "bold"),
        screen_advice(last.verdict.reason),
    )


def spot_text(spot: SpotState) -> Content:
    """Return the way to an earlier scan's spot."""
    style = "$success bold" if spot.is_reached else "bold"
    return Content.assemble((f"TO #{spot.counter} ", style), spot.sentence)


def area_text(area: AreaState, last: LastScan | None) -> Content:
    """Return the last scan's verdict in a word, what is covered, and the way to the next press."""
    if last is None:
        return Content(area.sentence)
    level = last.verdict.level
    return Content.assemble((f"{verdict_word(level)} #{last.counter} ", _VERDICT_STYLE[level]), area.sentence)


def area_complaint(texts: dict[str, str]) -> str:
    """Return what is wrong with an area's width or height; empty if nothing is."""
    for text in texts.values():
        try:
            length_mm = float(text)
        except ValueError:
            length_mm = 0.0
        if not 0.0 < length_mm <= MAX_AREA_MM:
            return f"A number of mm above 0 and at most {MAX_AREA_MM:.0f} is needed, not {text!r}"
    return ""


def cue_text(state: InstrumentState) -> str:
    """Return what to do now, in one sentence."""
    if state.activity == "out of order":
        return f"Out of order: {screen_advice(state.sentence)}"
    if state.activity in _ELSEWHERE:
        return _ELSEWHERE[state.activity]
    if state.activity != "ready":
        return f"{state.activity.capitalize()} ..."
    if state.scans_left == 0 and state.spot is None:
        return f"{NO_ROOM[0].upper()}{NO_ROOM[1:]}."
    if state.calibration.calibration_id is None:
        return "Not calibrated: open Calibrate (key 2, or hold the button)."
    if state.live is None:
        return "Push the button to switch the lights on."
    if state.spot and state.live.reading.advice in TOUCHES:
        return TOUCHES[state.live.reading.advice]
    sign = "> " if _is_ready(state) else ""
    return f"{sign}{screen_advice(state.live.reading.sentence)}"


def idle_sentence(state: InstrumentState) -> str:
    """Return why there is no live picture."""
    return screen_advice(state.sentence) or "Lights off: push the button."


def _is_ready(state: InstrumentState) -> bool:
    has_room = state.activity == "ready" and (state.scans_left != 0 or state.spot is not None)
    return has_room and state.live is not None and state.live.reading.advice == "ready"
