"""The textual app: four screens over one instrument; it polls the state several times a second and never blocks."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import ClassVar, Final

from msgspec import structs
from textual.app import App, SuspendNotSupported
from textual.binding import Binding, BindingType

from device.acquisition.guided_calibration import CalibrationProgress
from device.acquisition.selftest import Finding
from device.instrument.demo_faults import DEMO_FAULTS, DemoFaults
from device.instrument.events import (
    ButtonPushed,
    CalibrationStep,
    CaptureDone,
    CheckAsked,
    Checked,
    Event,
    Failed,
    Info,
    PairingChanged,
    PowerOffRequested,
    PressRefused,
    PressSeen,
    ScanFinished,
    SelfTested,
    ZeroChecked,
)
from device.instrument.instrument import Instrument
from device.instrument.state import AreaState, SpotState
from device.store.choices import Display
from device.tui.drawing.cells import ColourDepth
from device.tui.drawing.height_picture import FrameRateLimiter
from device.tui.drawing.text import measure_text
from device.tui.screens.base import InstrumentScreen, themes_for
from device.tui.screens.calibration import CalibrationScreen
from device.tui.screens.panels import ProgramInfo
from device.tui.screens.picture_viewer import view_picture
from device.tui.screens.scan import ScanScreen
from device.tui.screens.scans import ScansScreen
from device.tui.screens.setup import SetUpScreen
from device.tui.widgets.cells_view import HeightView
from device.tui.widgets.dialogs import ChoiceDialog, ConfirmDialog, Dialog, KeysDialog
from device.tui.widgets.navigation import Notice, Place, place_after
from hal.board_profile import SensorConfig

UPDATES_PER_S: Final = 10.0
SHOWN_OBJECTS: Final = ("pebbles", "coin", "step", "texture", "groove", "sphere-grid", "sinusoid")
"""Objects that key d presses, in turn; the way back needs one that does not repeat itself."""
WIDE_OBJECT: Final = "pebbles"
ASTRAY: Final = ((1.5, -1.0, 6.0), (-1.387, 1.151, -6.0))
"""Ways of demonstrated touches that know none, in turn from the spot and back: mm right, mm down, degrees clockwise."""
STILL: Final = (0.0, 0.0, 0.0)

FRAMEWORK_ACTIONS: Final = frozenset(
    {
        "app.focus_next",
        "app.focus_previous",
        "screen.copy_text",
        "scroll_left",
        "scroll_right",
        "page_left",
        "page_right",
    }
)
"""Of Textual, on every screen or list: not listed among its keys."""

CHECK_ANSWERS: Final = ("Repeat with the right ball", "It is the standard: FAILED")
"""Answers to `CheckAsked`; without one the press is repeated."""

STOPPED: Final = 130
"""Exit code of a program that Ctrl-C stopped."""

NOTICE_NS: Final = 20_000_000_000
"""Time that a notice stays; a failure stays until another notice, or a press."""

MIN_COLUMNS: Final = 40
MIN_ROWS: Final = 16


class RetroscanApp(App[str]):
    """The screens of one instrument; returns "off" if the machine is to be switched off.

    Parameters
    ----------
    instrument : running on another thread, or stepped by a test
    program : version, and folder of scans
    depth : the terminal's colours
    sensor : gives pixel pitch and columns
    is_twin : whether the operator is simulated and can press objects
    is_over : whether the instrument has stopped, so that the app must end
    updates_per_s : how often the state is polled; None if a test calls `show_state` itself
    faults : of a demonstration; None: no fault menu
    """

    CSS_PATH = "screens.tcss"
    ENABLE_COMMAND_PALETTE = False
    TITLE = "retroscan"
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("1", "go('scan')", "Scan", show=False),
        Binding("2", "go('calibrate')", "Calibrate", show=False),
        Binding("3", "go('scans')", "Scans", show=False),
        Binding("4", "go('set-up')", "Set-up", show=False),
        Binding("f", "faults", "faults"),
        Binding("question_mark", "keys", "keys", key_display="?"),
        Binding("q", "quit", "quit"),
        Binding("ctrl+c", "interrupt", "quit", show=False),
    ]

    def __init__(
        self,
        instrument: Instrument,
        program: ProgramInfo,
        depth: ColourDepth,
        sensor: SensorConfig,
        is_twin: bool,
        is_over: Callable[[], bool] = lambda: False,
        updates_per_s: float | None = UPDATES_PER_S,
        faults: DemoFaults | None = None,
    ) -> None:
        super().__init__(ansi_color=depth != "full")
        self.instrument = instrument
        self.program = program
        self.pitch_um = sensor.pixel_pitch_um
        self.field_um = sensor.pixel_pitch_um * sensor.columns
        self.is_twin = is_twin
        self._is_over = is_over
        self._faults = faults
        self.findings: list[Finding] = []
        self.notice: Notice | None = None
        self._noticed: tuple[Notice | None, int] = None, 0
        self._depth: ColourDepth = depth
        self._updates_per_s = updates_per_s
        self._live_rate = FrameRateLimiter(1.0 / UPDATES_PER_S)
        self._due_s: float | None = None
        self._demonstrated = 0
        self._touched = 0
        self._followed: SpotState | AreaState | None = None
        self._shown = SHOWN_OBJECTS[0]
        self._objects: dict[str, str] = {}
        self._last_event: Event | None = None
        for theme in themes_for(depth).values():
            self.register_theme(theme)
        self.theme = themes_for(depth)[instrument.state.settings.display].name

    async def on_mount(self) -> None:
        """Create the screens, open the first one and start polling."""
        for kind in (ScanScreen, CalibrationScreen, ScansScreen, SetUpScreen):
            self.add_mode(kind.PLACE, lambda kind=kind: kind(self.instrument, self._depth))  # type: ignore[misc]
        await self.go("scan")
        self.instrument.ask_about_checks()
        if self._updates_per_s:
            self.set_interval(1.0 / self._updates_per_s, self._tick)

    async def show_state(self) -> None:
        """Show the present state and handle the events since the last call."""
        for event in self.instrument.take_events():
            await self._handle(event)
        self._drop_stale_notice()
        if screen := self._current():
            screen.show_state(self.instrument.state, self._too_small() or self.notice)

    def _drop_stale_notice(self) -> None:
        """Drop a notice that was shown long enough, unless it says that something goes on or failed."""
        notice, since_ns = self._noticed
        if notice is not self.notice:
            self._noticed = self.notice, self.now_ns()
        elif notice and not notice.lasts and self.now_ns() - since_ns > NOTICE_NS:
            self.notice = None

    def _too_small(self) -> Notice | None:
        columns, rows = self.size
        if columns >= MIN_COLUMNS and rows >= MIN_ROWS:
            return None
        return Notice(f"too small, needs {MIN_COLUMNS}x{MIN_ROWS}", "error")

    def show_live(self) -> None:
        """Show the live picture."""
        if screen := self._current():
            screen.show_live(self.instrument.state)

    def now_ns(self) -> int:
        """Return monotonic time of the machine, in which pairing windows end."""
        return time.monotonic_ns()

    def report_failure(self, sentence: str) -> None:
        """Show a failure in the notice line."""
        self.notice = Notice(sentence, "error")

    async def action_quit(self) -> None:
        """Quit; during a calibration ask first."""
        self._leave(0)

    def action_interrupt(self) -> None:
        """Quit as `action_quit` does, with the exit code of a program that Ctrl-C stopped."""
        self._leave(STOPPED)

    def _leave(self, exit_code: int) -> None:
        if self.instrument.state.activity != "calibrating":
            self.exit(return_code=exit_code)
            return
        question = "Stop the calibration? The previous one stays active."
        leave = ConfirmDialog(question, "Stop")
        self.push_screen(leave, lambda yes: self.exit(return_code=exit_code) if yes else None)

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Only a demonstration has faults to switch."""
        return self._faults is not None if action == "faults" else super().check_action(action, parameters)

    def action_keys(self) -> None:
        """Show every key of this screen, also those that the bottom line leaves out."""
        if isinstance(self.screen, Dialog):
            return
        keys: dict[str, str] = {}
        for active in self.screen.active_bindings.values():
            binding = active.binding
            what = binding.tooltip or binding.description
            if what and active.enabled and binding.action not in FRAMEWORK_ACTIONS:
                keys.setdefault(self.get_key_display(binding), what)
        self.push_screen(KeysDialog(list(keys.items())))

    def action_faults(self) -> None:
        """Choose a fault of the twin to switch on or off."""
        if self._faults is None or isinstance(self.screen, Dialog):
            return
        active = self._faults.active
        lines = [f"[{'x' if name in active else ' '}] {name}: {words}" for name, words in DEMO_FAULTS]
        self.push_screen(ChoiceDialog("Faults of the twin: Enter switches one on or off", lines), self._toggle_fault)

    def _toggle_fault(self, chosen: int | None) -> None:
        if self._faults is not None and chosen is not None:
            self._faults.toggle(DEMO_FAULTS[chosen][0])

    def on_height_view_picture_wanted(self, event: HeightView.PictureWanted) -> None:
        """Suspend the screens and draw the relief in pixels, if the terminal can."""
        try:
            with self.suspend():
                shown = view_picture(event.height, "Quick look", sys.__stderr__ or sys.stderr)
        except SuspendNotSupported:
            shown = False
        if not shown:
            self.report_failure("This terminal has no graphics (sixel, kitty): use foot, kitty or xterm -ti vt340")

    async def on_height_view_measured(self, event: HeightView.Measured) -> None:
        """Show what lies between two points of a quick look."""
        flatness_um = self.instrument.state.health.flat_residual_um
        self.notice = Notice(measure_text(event.height, event.first, event.second, flatness_um))
        await self.show_state()

    def switch_display(self) -> None:
        """Show the screens in the other of dark and light, also after a restart."""
        settings = self.instrument.state.settings
        display: Display = "dark" if settings.display == "light" else "light"
        self.instrument.set_settings(structs.replace(settings, display=display))
        self.theme = themes_for(self._depth)[display].name

    def demonstrate(self) -> None:
        """Let the twin's operator press the next object, or follow the way to a spot or over an area."""
        state, way = self.instrument.state, None
        if state.spot:
            self._shown = self._objects.get(state.spot.scan_id, self._shown)
            way = state.spot.way or ASTRAY[self._touched % len(ASTRAY)]
        elif state.area:
            self._shown, way = WIDE_OBJECT, state.area.way
        else:
            self._shown = SHOWN_OBJECTS[self._demonstrated % len(SHOWN_OBJECTS)]
            self._demonstrated += 1
        followed = state.spot or state.area
        if followed and followed is self._followed:  # The hand went this way already: it presses there again.
            way = STILL
        elif followed and state.spot and not state.spot.way:
            self._touched += 1
        self._followed = followed
        self.instrument.demonstrate(self._shown, way, pushes=False)

    async def action_go(self, place: Place) -> None:
        """Open a screen."""
        await self.go(place)

    async def go(self, place: Place) -> None:
        """Open a screen; the button scans on the first one and navigates on the others. Failures go along."""
        if place != self.current_mode and self.notice and not self.notice.lasts:
            self.notice = None
        await self.switch_mode(place)
        self.instrument.redirect_button(short_too=place != "scan")
        self.instrument.show_live(place in {"scan", "calibrate"})
        await self.show_state()
        self.show_live()

    async def _tick(self) -> None:
        """Show the state, and the live picture as often as the terminal can keep up."""
        now_s = time.monotonic()
        if self._due_s is not None:
            self._live_rate.tick(now_s - self._due_s)
        self._due_s = now_s + 1.0 / UPDATES_PER_S
        if self._is_over():
            self.exit()
        await self.show_state()
        if self._live_rate.is_due(now_s):
            self.show_live()

    async def _handle(self, event: Event) -> None:
        self.notice = notice_for(event) or self.notice
        last, self._last_event = self._last_event, event
        match event:
            case PressSeen() | CalibrationStep(progress=CalibrationProgress(is_over=False)):
                self.notice = None
            case ScanFinished(fault="", scan_id=scan_id) if not isinstance(last, Checked):
                self._objects[scan_id] = self._shown
                self.notice = None
            case ButtonPushed(held_long=held_long):
                await self._pushed(held_long)
            case CheckAsked(question=question):
                self._ask_about_check(question)
            case SelfTested(finding=finding):
                self.findings.append(finding)
            case PowerOffRequested():
                self.exit("off")

    def _ask_about_check(self, question: str) -> None:
        """Ask whether the right ball lies on the gel; the instrument's button answers too."""
        self.instrument.redirect_button(short_too=True)
        self.push_screen(ChoiceDialog(question, CHECK_ANSWERS), self._answer_check)

    def _answer_check(self, chosen: int | None) -> None:
        self.instrument.answer_check(is_standard=chosen == 1)
        screen = self._current()
        self.instrument.redirect_button(short_too=screen is None or screen.PLACE != "scan")

    async def _pushed(self, held_long: bool) -> None:
        """Handle the instrument's button: a short push chooses the next item, a long one starts it or goes on."""
        front, screen = self.screen, self._current()
        if isinstance(front, Dialog):
            front.pushed(held_long)
        elif screen and not held_long:
            await screen.short_push()
        elif screen and not await screen.long_push():
            await self.go(place_after(screen.PLACE))

    def _current(self) -> InstrumentScreen | None:
        """Return the instrument's screen, also behind a dialog."""
        screens = (screen for screen in self.screen_stack if isinstance(screen, InstrumentScreen))
        return next((screen for screen in screens if screen.is_mounted), None)


def notice_for(event: Event) -> Notice | None:
    """Return the notice for an event; None keeps the last one."""
    match event:
        case CaptureDone():
            return Notice("You may lift.", "success")
        case PressRefused(sentence=sentence):
            return Notice(f"Not scanned: {sentence}", "error")
        case Failed(sentence=sentence):
            return Notice(sentence, "error")
        case Info(sentence=sentence):
            return Notice(sentence)
        case ZeroChecked(passed=passed, sentence=sentence):
            return Notice(sentence, "success" if passed else "error")
        case Checked(passed=passed, sentence=sentence):
            return Notice(sentence, "success" if passed else "error")
        case PairingChanged(sentence=sentence):
            return Notice(sentence)
        case CalibrationStep(progress=progress) if progress.phase == "passed":
            return Notice(progress.instruction, "success")
        case CalibrationStep(progress=progress) if progress.phase == "failed":
            return Notice(progress.instruction, "error")
        case ScanFinished(fault=fault) if fault:
            return Notice(f"Scan stored without a quick look: {fault}", "error")
        case _:
            return None
