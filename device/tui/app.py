"""The textual app: four screens over one instrument; it looks at the state many times a second and never waits."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import ClassVar, Final

from textual.app import App, SuspendNotSupported
from textual.binding import Binding, BindingType

from device.scanning.guided_calibration import CalibrationProgress
from device.scanning.selftest import Finding
from device.session.events import (
    ButtonPushed,
    CalibrationStep,
    Event,
    PowerOffAsked,
    PressSeen,
    ScanFinished,
    SelfTested,
)
from device.session.instrument import Instrument
from device.tui.calibration_screen import CalibrationScreen
from device.tui.dialogs import ConfirmDialog, Dialog
from device.tui.hearing import notice_of
from device.tui.height_view import HeightView
from device.tui.instrument_screen import InstrumentScreen
from device.tui.live_pace import LivePace
from device.tui.navigation import Place, place_after
from device.tui.notice import Notice
from device.tui.picture_viewing import view_picture
from device.tui.scan_screen import ScanScreen
from device.tui.scans_screen import ScansScreen
from device.tui.setup_screen import SetUpScreen
from device.tui.sheets import ProgramFacts
from device.tui.terminal import ColourDepth
from device.tui.theme import theme_for
from hal.board_profile import SensorFacts

LOOKS_PER_S: Final = 10.0
SHOWN_OBJECTS: Final = ("coin", "texture", "sphere-grid", "sinusoid", "step", "groove")
"""What the twin presses, one after the other."""


class RetroscanApp(App[str]):
    """The screens of one instrument; what it returns is "off" when the machine is to be switched off.

    Parameters
    ----------
    instrument : running on another thread, or stepped by a test
    program : its version, and the folder of its scans
    depth : the terminal's colours
    sensor : pitch and columns of its pixels on the skin
    is_twin : whether objects can be asked for
    is_over : whether the instrument has stopped for good, so that nothing is left to be shown
    looks_per_s : how often the state is looked at; None when a test calls `look` itself
    """

    CSS_PATH = "screens.tcss"
    ENABLE_COMMAND_PALETTE = False
    TITLE = "retroscan"
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("1", "go('scan')", show=False),
        Binding("2", "go('calibrate')", show=False),
        Binding("3", "go('scans')", show=False),
        Binding("4", "go('set-up')", show=False),
        Binding("q,ctrl+c", "quit", "quit"),
    ]

    def __init__(
        self,
        instrument: Instrument,
        program: ProgramFacts,
        depth: ColourDepth,
        sensor: SensorFacts,
        is_twin: bool,
        is_over: Callable[[], bool] = lambda: False,
        looks_per_s: float | None = LOOKS_PER_S,
    ) -> None:
        super().__init__(ansi_color=depth != "full")
        self.instrument = instrument
        self.program = program
        self.pitch_um = sensor.pixel_pitch_um
        self.field_um = sensor.pixel_pitch_um * sensor.columns
        self.is_twin = is_twin
        self._is_over = is_over
        self.findings: list[Finding] = []
        self.notice: Notice | None = None
        self._depth: ColourDepth = depth
        self._looks_per_s = looks_per_s
        self._pace = LivePace(1.0 / LOOKS_PER_S)
        self._due_s: float | None = None
        self._demonstrated = 0
        theme = theme_for(depth)
        self.register_theme(theme)
        self.theme = theme.name

    async def on_mount(self) -> None:
        """Make the screens, open the first and begin to look."""
        for kind in (ScanScreen, CalibrationScreen, ScansScreen, SetUpScreen):
            self.add_mode(kind.PLACE, lambda kind=kind: kind(self.instrument, self._depth))  # type: ignore[misc]
        await self.go("scan")
        if self._looks_per_s:
            self.set_interval(1.0 / self._looks_per_s, self._tick)

    async def look(self) -> None:
        """Show the present state and what happened since the last look."""
        for event in self.instrument.take_events():
            await self._hear(event)
        if screen := self._current():
            screen.look(self.instrument.state, self.notice)

    def look_live(self) -> None:
        """Show the live picture."""
        if screen := self._current():
            screen.look_live(self.instrument.state)

    def now_ns(self) -> int:
        """The machine's monotonic time, as pairing windows count it."""
        return time.monotonic_ns()

    def tell_failure(self, sentence: str) -> None:
        """Say what failed."""
        self.notice = Notice(sentence, "failed")

    async def action_quit(self) -> None:
        """Leave the screens; a calibration that is going on is only given up when that is meant."""
        if self.instrument.state.activity != "calibrating":
            self.exit()
            return
        question = "Give up the calibration? The one before stays in force."
        self.push_screen(ConfirmDialog(question, "Give up"), lambda yes: self.exit() if yes else None)

    def on_height_view_picture_wanted(self, event: HeightView.PictureWanted) -> None:
        """Step aside for a picture to the pixel, where the terminal can draw one."""
        try:
            with self.suspend():
                shown = view_picture(event.height, "Quick look", sys.__stderr__ or sys.stderr)
        except SuspendNotSupported:
            shown = False
        if not shown:
            self.tell_failure("This terminal draws no pictures (sixel, kitty): use foot, kitty or xterm -ti vt340")

    def demonstrate(self) -> None:
        """Have the twin press its next object."""
        self.instrument.demonstrate(SHOWN_OBJECTS[self._demonstrated % len(SHOWN_OBJECTS)])
        self._demonstrated += 1

    async def action_go(self, place: Place) -> None:
        """Open a screen."""
        await self.go(place)

    async def go(self, place: Place) -> None:
        """Open a screen; the button scans on the first one and leads through the others."""
        await self.switch_mode(place)
        self.instrument.lend_button(short_too=place != "scan")
        await self.look()
        self.look_live()

    async def _tick(self) -> None:
        """Look; and where the terminal keeps up, show the live picture."""
        now_s = time.monotonic()
        if self._due_s is not None:
            self._pace.tick(now_s - self._due_s)
        self._due_s = now_s + 1.0 / LOOKS_PER_S
        if self._is_over():
            self.exit()
        await self.look()
        if self._pace.is_due(now_s):
            self.look_live()

    async def _hear(self, event: Event) -> None:
        self.notice = notice_of(event) or self.notice
        match event:
            case PressSeen() | ScanFinished(fault="") | CalibrationStep(progress=CalibrationProgress(is_over=False)):
                self.notice = None
            case ButtonPushed(held_long=held_long):
                await self._pushed(held_long)
            case SelfTested(finding=finding):
                self.findings.append(finding)
            case PowerOffAsked():
                self.exit("off")

    async def _pushed(self, held_long: bool) -> None:
        """The instrument's one button: a short push is the next choice, a long one does it or goes on."""
        front, screen = self.screen, self._current()
        if isinstance(front, Dialog):
            front.pushed(held_long)
        elif screen and not held_long:
            await screen.short_push()
        elif screen and not await screen.long_push():
            await self.go(place_after(screen.PLACE))

    def _current(self) -> InstrumentScreen | None:
        """The instrument's screen, also when a dialog stands before it."""
        screens = (screen for screen in self.screen_stack if isinstance(screen, InstrumentScreen))
        return next((screen for screen in screens if screen.is_mounted), None)
