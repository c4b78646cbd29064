"""The textual app: four screens over one instrument; it looks at the state many times a second and never waits."""

from __future__ import annotations

import time
from typing import ClassVar, Final

from textual.app import App
from textual.binding import Binding, BindingType
from textual.screen import Screen

from device.scanning.selftest import Finding
from device.session.events import (
    CalibrationStep,
    Event,
    Failed,
    MayLift,
    PairingChanged,
    PowerOffAsked,
    PressRefused,
    PressSeen,
    ScanFinished,
    SelfTested,
    Told,
    ZeroChecked,
)
from device.session.instrument import Instrument
from device.tui.calibration_screen import CalibrationScreen
from device.tui.instrument_screen import InstrumentScreen
from device.tui.live_pace import LivePace
from device.tui.navigation import Place
from device.tui.notice import Notice
from device.tui.scan_screen import ScanScreen
from device.tui.scans_screen import ScansScreen
from device.tui.setup_screen import SetUpScreen
from device.tui.sheets import MachineFacts
from device.tui.terminal import ColourDepth
from device.tui.theme import theme_for

LOOKS_PER_S: Final = 10.0
SHOWN_OBJECTS: Final = ("coin", "texture", "sphere-grid", "sinusoid", "step", "groove")
"""What the twin presses, one after the other."""


class RetroscanApp(App[str]):
    """The screens of one instrument; what it returns is "off" when the machine is to be switched off.

    Parameters
    ----------
    instrument : already running on another thread, or stepped by a test
    machine : name, addresses and key of this machine
    field_mm : width of the field, mm
    is_twin : whether objects can be asked for
    """

    CSS_PATH = "screens.tcss"
    ENABLE_COMMAND_PALETTE = False
    TITLE = "retroscan"
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("1", "go('scan')", show=False),
        Binding("2", "go('calibrate')", show=False),
        Binding("3", "go('scans')", show=False),
        Binding("4", "go('set-up')", show=False),
        Binding("q", "quit", "quit"),
    ]

    def __init__(
        self, instrument: Instrument, machine: MachineFacts, depth: ColourDepth, field_mm: float, is_twin: bool
    ) -> None:
        super().__init__()
        self.instrument = instrument
        self.machine = machine
        self.depth: ColourDepth = depth
        self.field_mm = field_mm
        self.is_twin = is_twin
        self.findings: list[Finding] = []
        self.notice: Notice | None = None
        self._shown = 0
        self._pace = LivePace(1.0 / LOOKS_PER_S)
        self._due_s: float | None = None
        theme = theme_for(depth)
        self.register_theme(theme)
        self.theme = theme.name

    def on_mount(self) -> None:
        """Make the screens and begin to look."""
        self.add_mode("scan", lambda: ScanScreen(self.instrument, self.depth))
        self.add_mode("calibrate", lambda: CalibrationScreen(self.instrument, self.depth))
        self.add_mode("scans", lambda: ScansScreen(self.instrument, self.depth))
        self.add_mode("set-up", lambda: SetUpScreen(self.instrument, self.depth))
        self.switch_mode("scan")
        self.set_interval(1.0 / LOOKS_PER_S, self._tick)
