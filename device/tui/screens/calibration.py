"""Calibrate: one instruction at a time, the detected circle, growing coverage, and the numbers at the end."""

from __future__ import annotations

from collections.abc import Iterable
from typing import ClassVar, Final

from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical
from textual.widget import Widget

from device.acquisition.guided_calibration import CalibrationProgress
from device.bundles.check import COMMON_RADII_UM
from device.instrument.instrument import Instrument
from device.instrument.state import InstrumentState
from device.instrument.state import LiveView as LivePicture
from device.tui.drawing.cells import ColourDepth
from device.tui.drawing.height_picture import Circle
from device.tui.drawing.text import check_lines, coverage_lines, gauge_text, hanging, screen_advice
from device.tui.screens.base import InstrumentScreen
from device.tui.widgets.cells_view import LiveView
from device.tui.widgets.navigation import Words

RADII_MM: Final = tuple(radius_um * 1e-3 for radius_um in COMMON_RADII_UM)
"""Radii to choose from; never typed."""

LAST_PRESSES: Final = 3
"""What is uncovered is said from so many presses before the end: planned places cover the rest."""

_CONTACT_FRACTION: Final = 0.6
"""Contact radius to aim for, as a fraction of the ball's radius."""

_INTRODUCTION: Final = (
    "You need a clean, mounted gel and a polished steel ball.",
    "First a frame of the untouched skin, then the ball at twelve places: less than three minutes.",
    "The active calibration changes only if the new one passes.",
)


class CalibrationScreen(InstrumentScreen):
    """The guided calibration."""

    PLACE = "calibrate"
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("space,enter", "go_on", "start / take"),
        Binding("r", "radius", "ball radius"),
        Binding("x", "stop", "stop"),
    ]

    def __init__(self, instrument: Instrument, depth: ColourDepth, radius_mm: float = 3.0) -> None:
        super().__init__(instrument)
        self._radius_mm = radius_mm
        self._fitting_since_ns: int | None = None
        self._live = LiveView(depth)
        self._instructions = Words(id="instruction", markup=False)
        self._progress = Words(id="progress", markup=False)
        self._coverage = Words(id="coverage", markup=False)
        self._figures = Words(id="details", markup=False)

    def body(self) -> Iterable[Widget]:
        """Instruction above; live picture with circles on the left; progress, coverage and numbers on the right."""
        yield self._instructions
        with Horizontal(id="guide"):
            yield self._live
            with Vertical(id="guide-side"):
                yield self._progress
                yield self._coverage
                yield self._figures

    def show_body(self, state: InstrumentState) -> None:
        """Update instruction, progress, coverage and numbers."""
        guide = state.guide
        self._instructions.update(self._instruction(state))
        taken, wanted = (guide.accepted, guide.wanted) if guide else (0, 12)
        width = max(self._progress.size.width, 24)
        gauge = gauge_text("presses", taken / wanted, width, f" {taken} of {wanted}")
        self._progress.update(gauge)
        self._coverage.update("\n".join(coverage_lines(guide.coverage if guide else None)))
        details = [hanging(line, width, indent) for line, indent in self._details(guide)]
        self._figures.update("\n".join(details))
        self.refresh_bindings()

    def show_live(self, state: InstrumentState) -> None:
        """Show the live picture with the detected circle and the next place."""
        if state.live is None:
            self._live.show(None, sentence=state.sentence or "Waiting for the camera.")
            return
        self._live.show(state.live.picture, circles_of(state.guide, state.live, self._aimed_radius()))

    def action_go_on(self) -> None:
        """Start, or take the requested frame."""
        if self._is_running(self.instrument.state):
            self.instrument.press()
        else:
            self.instrument.start_calibration(self._radius_mm)

    def action_radius(self) -> None:
        """Choose the next ball radius."""
        larger = [radius for radius in RADII_MM if radius > self._radius_mm]
        self._radius_mm = larger[0] if larger else RADII_MM[0]
        self.show_body(self.instrument.state)

    def action_stop(self) -> None:
        """Stop; the previous calibration stays active."""
        self.instrument.cancel_run()

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Return the ball can be chosen before a calibration, stopping is possible during one."""
        running = self._is_running(self.instrument.state)
        if action in {"radius", "stop"}:
            return running == (action == "stop")
        return super().check_action(action, parameters)

    async def short_push(self) -> None:
        """Start a calibration."""
        self.action_go_on()

    def _instruction(self, state: InstrumentState) -> str:
        if state.guide and state.guide.phase == "fitting" and self._is_running(state):
            self._fitting_since_ns = self._fitting_since_ns or self.retroscan.now_ns()
            spent_s = (self.retroscan.now_ns() - self._fitting_since_ns) * 1e-9
            return f"{state.guide.instruction} {spent_s:.0f} s, about a minute on a small board. Touch nothing."
        self._fitting_since_ns = None
        if state.activity == "balancing":
            return "The exposure is being balanced: finish it, or stop it there (key 4)."
        if state.guide and (self._is_running(state) or state.guide.is_over):
            again = "" if self._is_running(state) else " Push the button to calibrate again."
            complaint = f" ({state.guide.complaint})" if state.guide.complaint and not state.guide.is_over else ""
            sign = "! " if state.guide.phase == "failed" else ""
            return screen_advice(f"{sign}{state.guide.instruction}{complaint}{again}")
        return f"Ball of {self._radius_mm:g} mm radius (key r: another). Push the button to start."

    def _details(self, guide: CalibrationProgress | None) -> list[tuple[str, int]]:
        """Return lines, each with the indent of its continuation lines."""
        if guide is None:
            return [(line, 0) for line in _INTRODUCTION]
        if guide.is_over:
            bright = guide.brightness
            notes = (bright.warning or bright.sentence,) if bright else ()
            checks = [(line, 6) for line in check_lines(guide.checks)]
            return checks + [(line, 2) for line in (*notes, *guide.next_presses)]
        return [(line, 2) for line in self._last_press(guide)]

    def _last_press(self, guide: CalibrationProgress) -> list[str]:
        """Return lines on the last press."""
        pitch_mm = self.retroscan.pitch_um * 1e-3
        found = [
            f"Ball found, contact diameter {2.0 * ball.contact_radius_px * pitch_mm:.1f} mm." for ball in guide.circles
        ]
        refused = [f"Not used: {ball.reason}." for ball in guide.rejected]
        is_ending = guide.wanted - guide.accepted <= LAST_PRESSES
        return [*found, *refused, *(guide.next_presses if is_ending else ())]

    def _aimed_radius(self) -> float:
        """Return contact radius to aim for, as a fraction of the field's columns."""
        return _CONTACT_FRACTION * self._radius_mm / (self.retroscan.field_um * 1e-3)

    @staticmethod
    def _is_running(state: InstrumentState) -> bool:
        return state.activity == "calibrating"


def circles_of(guide: CalibrationProgress | None, live: LivePicture, aimed: float) -> tuple[Circle, ...]:
    """Return the circles to draw: found and refused ones of the last press, and the next place."""
    if guide is None or guide.is_over:
        return ()
    rows, columns = (size * live.step for size in live.picture.shape[:2])
    found = [
        Circle("found", ball.column / columns, ball.row / rows, ball.contact_radius_px / columns)
        for ball in guide.circles
    ]
    refused = [Circle("refused", ball.column / columns, ball.row / rows, aimed / 2.0) for ball in guide.rejected]
    place = [Circle("wanted", *guide.place, aimed, "press here")] if guide.place else []
    return tuple(found + refused + place)
