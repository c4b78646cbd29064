"""Settings of the machine in Set-up: brightness of the panel, clock and time zone."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from datetime import datetime
from functools import partial
from typing import Any, Final

from device.errors import DeviceError, MachineError
from device.machine.interfaces import ClockStatus, Machine
from device.tui.drawing.text import clock_text, hanging
from device.tui.screens.base import InstrumentScreen
from device.tui.screens.setup_actions import ActionName
from device.tui.widgets.dialogs import ChoiceDialog, FieldsDialog
from device.tui.widgets.navigation import Notice

LEVELS: Final = (1.0, 0.75, 0.5, 0.25, 0.1)
"""Brightness levels, in the order in which they follow each other."""

NO_PANEL: Final = "This machine has no panel whose brightness can be set."

TIME_HINT: Final = "As clocks at this place show it, for example 2026-11-23 and 14:05"

ELSEWHERE: Final = "other"
"""Region of the zones whose names have none, such as UTC."""

Read = Callable[[Callable[[], Any], Callable[[Any], None]], None]
"""Calls the first function on another thread, and the second one with its result."""


class MachineActions:
    """Panels and dialogs of the machine's settings.

    Parameters
    ----------
    screen : that shows the dialogs
    machine : whose settings these are
    read : calls slow functions
    """

    def __init__(self, screen: InstrumentScreen, machine: Machine, read: Read) -> None:
        self._screen = screen
        self._machine = machine
        self._read = read
        self._facts: dict[ActionName, str] = {}

    def refresh(self) -> None:
        """Read all settings again, for the panels."""
        settings: dict[ActionName, Callable[[], str]] = {
            "brightness": self._brightness_facts,
            "clock": self._clock_facts,
        }
        for name, facts in settings.items():
            self._read(partial(_sentence_of, facts), partial(self._keep, name))

    def panel(self, name: ActionName, meaning: str, now: datetime, columns: int) -> str:
        """The panel of a setting: its present state, and its meaning."""
        facts = [self._facts.get(name, "...")]
        if name == "clock":
            facts = [clock_text(now), *facts]
        if facts == [NO_PANEL]:
            return NO_PANEL
        return "\n".join([*(hanging(fact, columns, 0) for fact in facts), "", meaning])

    def start(self, name: ActionName) -> None:
        """Change a setting, or ask for its new value."""
        if name == "brightness":
            self._change(self._next_level)
        else:
            choices = ["Set date and time", "Set the time zone"]
            self._screen.app.push_screen(ChoiceDialog("Clock", choices), self._ask_about_clock)

    def _keep(self, name: ActionName, facts: str) -> None:
        self._facts[name] = facts
        self._screen.show_body(self._screen.instrument.state)

    def _change(self, change: Callable[[], str]) -> None:
        """Change a setting on another thread, say what it is now, and read all again."""
        self._read(change, self._changed)

    def _changed(self, sentence: str) -> None:
        self._screen.retroscan.notice = Notice(sentence)
        self.refresh()

    def _brightness_facts(self) -> str:
        level = self._machine.backlight.level()
        return NO_PANEL if level is None else f"Now {level:.0%}."

    def _next_level(self) -> str:
        backlight = self._machine.backlight
        present = backlight.level()
        if present is None:
            raise MachineError(NO_PANEL)
        following = next((level for level in LEVELS if level < present - 0.02), LEVELS[0])
        backlight.set_level(following)
        return f"Brightness {following:.0%}."

    def _clock_facts(self) -> str:
        return _clock_words(self._machine.clock.status())

    def _ask_about_clock(self, chosen: int | None) -> None:
        if chosen == 0:
            now = self._screen.instrument.wall_time().astimezone()
            fields = {"Date": f"{now:%Y-%m-%d}", "Time": f"{now:%H:%M}"}
            self._screen.app.push_screen(FieldsDialog("Date and time", fields, TIME_HINT, _complaint), self._set_time)
        elif chosen == 1:
            self._read(self._machine.clock.zones, self._ask_for_region)

    def _set_time(self, fields: dict[str, str] | None) -> None:
        if fields is not None:
            self._change(partial(self._set_time_to, _time_of(fields)))

    def _set_time_to(self, local: datetime) -> str:
        self._machine.clock.set_time(local)
        return f"The clock is set to {local:%Y-%m-%d %H:%M}. Scans keep their numbers and their order."

    def _ask_for_region(self, zones: Sequence[str]) -> None:
        regions = sorted({_region(zone) for zone in zones})
        self._screen.app.push_screen(ChoiceDialog("Region", regions), partial(self._ask_for_zone, zones, regions))

    def _ask_for_zone(self, zones: Sequence[str], regions: Sequence[str], chosen: int | None) -> None:
        if chosen is None:
            return
        within = [zone for zone in zones if _region(zone) == regions[chosen]]
        self._screen.app.push_screen(ChoiceDialog("Time zone", within), partial(self._set_zone, within))

    def _set_zone(self, zones: Sequence[str], chosen: int | None) -> None:
        if chosen is not None:
            self._change(partial(self._set_zone_to, zones[chosen]))

    def _set_zone_to(self, name: str) -> str:
        self._machine.clock.set_zone(name)
        return f"The time zone is {name}."


def _sentence_of(facts: Callable[[], str]) -> str:
    """Facts for a panel, or why there are none."""
    try:
        return facts()
    except DeviceError as error:
        return f"! {error}"


def _clock_words(status: ClockStatus) -> str:
    confirmed = "confirmed by a time server" if status.is_synchronized else "not confirmed by a time server"
    return f"Zone {status.time_zone}; {confirmed}."


def _region(zone: str) -> str:
    region, slash, _ = zone.partition("/")
    return region if slash else ELSEWHERE


def _time_of(fields: dict[str, str]) -> datetime:
    return datetime.fromisoformat(f"{fields['Date']}T{fields['Time']}")


def _complaint(fields: dict[str, str]) -> str:
    """What is wrong with a date and time; empty if nothing is."""
    try:
        local = _time_of(fields)
    except ValueError:
        return "write a date such as 2026-11-23 and a time such as 14:05"
    return "" if local.tzinfo is None else "write the time without a zone"
