"""Settings of the machine in Set-up: brightness of the panel, clock and time zone, Wi-Fi."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from typing import Final, Literal

from device.errors import DeviceError, MachineError
from device.machine.interfaces import ClockStatus, WifiNetwork
from device.machine.wifi import password_complaint
from device.tui.drawing.text import clock_text, hanging
from device.tui.screens.base import InstrumentScreen
from device.tui.widgets.dialogs import ChoiceDialog, FieldsDialog
from device.tui.widgets.navigation import Notice

LEVELS: Final = (1.0, 0.75, 0.5, 0.25, 0.1)
"""Brightness levels, in the order in which they follow each other."""

NO_PANEL: Final = "This machine has no panel whose brightness can be set."

TIME_HINT: Final = "As clocks at this place show it, for example 2026-11-23 and 14:05"

ELSEWHERE: Final = "other"
"""Region of the zones whose names have none, such as UTC."""

KEY: Final = "Password"
KEY_HINT: Final = "8 to 63 characters · Enter: join · Escape: cancel"


class MachineActions:
    """Panels and dialogs of the machine's settings.

    Parameters
    ----------
    screen : that shows the dialogs
    """

    def __init__(self, screen: InstrumentScreen) -> None:
        self._screen = screen
        self._machine = screen.instrument.machine
        self._facts: dict[ActionName, str] = {}

    def refresh(self) -> None:
        """Read all settings again, for the panels."""
        settings: dict[ActionName, Callable[[], str]] = {
            "brightness": self._brightness_facts,
            "clock": self._clock_facts,
            "wifi": self._wifi_facts,
        }
        for name, facts in settings.items():
            self._screen.work(partial(_sentence_of, facts), partial(self._keep, name))

    def panel(self, name: ActionName, meaning: str, now: datetime, columns: int) -> str:
        """Return the panel of a setting: its present state, and its meaning."""
        facts = [self._facts.get(name, "...")]
        if name == "clock":
            facts = [clock_text(now), *facts]
        if facts == [NO_PANEL]:
            return NO_PANEL
        return "\n".join([*(hanging(fact, columns, 0) for fact in facts), "", meaning])

    def start(self, name: ActionName) -> None:
        """Change a setting, or ask for its new value."""
        if name == "brightness":
            self._screen.work(self._next_level, self._changed)
        elif name == "wifi":
            self._screen.retroscan.notice = Notice("Looking for networks ...")
            self._screen.work(self._machine.wifi.networks, self._ask_for_network)
        else:
            choices = ["Set date and time", "Set the time zone"]
            self._screen.ask(ChoiceDialog("Clock", choices), self._ask_about_clock)

    def _keep(self, name: ActionName, facts: str) -> None:
        self._facts[name] = facts
        self._screen.show_body(self._screen.instrument.state)

    def _change(self, change: Callable[[], object], sentence: str) -> None:
        """Change a setting on another thread, say what it is now, and read all again."""
        self._screen.work(change, lambda _: self._changed(sentence))

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

    def _wifi_facts(self) -> str:
        name = self._machine.wifi.active()
        return f"In the network {name}." if name else "In no Wi-Fi network."

    def _ask_for_network(self, networks: Sequence[WifiNetwork]) -> None:
        self._screen.retroscan.notice = None
        if not networks:
            self._screen.retroscan.report_failure("No Wi-Fi network is in range: go closer to its access point")
            return
        lines = [_network_line(network) for network in networks]
        dialog = ChoiceDialog("Which Wi-Fi network?", lines)
        self._screen.ask(dialog, partial(self._join_chosen, networks))

    def _join_chosen(self, networks: Sequence[WifiNetwork], chosen: int) -> None:
        network = networks[chosen]
        if network.security != "password":
            self._join(network, "")
            return
        dialog = FieldsDialog(network.name, {KEY: ""}, KEY_HINT, _password_wrong, secret=KEY)
        self._screen.ask(dialog, lambda fields: self._join(network, fields[KEY]))

    def _join(self, network: WifiNetwork, password: str) -> None:
        self._screen.retroscan.notice = Notice(f"Joining {network.name} ...")
        joined = f"Joined {network.name}; it is joined again whenever it is in range."
        self._change(partial(self._machine.wifi.join, network, password), joined)

    def _ask_about_clock(self, chosen: int) -> None:
        if chosen == 0:
            now = self._screen.instrument.wall_time().astimezone()
            fields = {"Date": f"{now:%Y-%m-%d}", "Time": f"{now:%H:%M}"}
            self._screen.ask(FieldsDialog("Date and time", fields, TIME_HINT, _complaint), self._set_time)
        elif chosen == 1:
            self._screen.work(self._machine.clock.zones, self._ask_for_region)

    def _set_time(self, fields: dict[str, str]) -> None:
        local = _time_of(fields)
        sentence = f"The clock is set to {local:%Y-%m-%d %H:%M}. Scans keep their numbers and their order."
        self._change(partial(self._machine.clock.set_time, local), sentence)

    def _ask_for_region(self, zones: Sequence[str]) -> None:
        regions = sorted({_region(zone) for zone in zones})
        self._screen.ask(ChoiceDialog("Region", regions), partial(self._ask_for_zone, zones, regions))

    def _ask_for_zone(self, zones: Sequence[str], regions: Sequence[str], chosen: int) -> None:
        within = [zone for zone in zones if _region(zone) == regions[chosen]]
        self._screen.ask(ChoiceDialog("Time zone", within), partial(self._set_zone, within))

    def _set_zone(self, zones: Sequence[str], chosen: int) -> None:
        name = zones[chosen]
        self._change(partial(self._machine.clock.set_zone, name), f"The time zone is {name}.")


def _sentence_of(facts: Callable[[], str]) -> str:
    """Return facts for a panel, or why there are none."""
    try:
        return facts()
    except DeviceError as error:
        return f"! {error}"


def _clock_words(status: ClockStatus) -> str:
    confirmed = "confirmed by a time server" if status.is_synchronized else "not confirmed by a time server"
    return f"Zone {status.time_zone}; {confirmed}."


def _network_line(network: WifiNetwork) -> str:
    kind = {"open": "open", "password": "", "unsupported": "cannot be joined"}[network.security]
    mark = "joined" if network.is_active else kind
    return f"{network.signal:>4.0%} {network.name} {mark}".rstrip()


def _password_wrong(fields: dict[str, str]) -> str:
    return password_complaint(fields[KEY])


def _region(zone: str) -> str:
    region, slash, _ = zone.partition("/")
    return region if slash else ELSEWHERE


def _time_of(fields: dict[str, str]) -> datetime:
    return datetime.fromisoformat(f"{fields['Date']}T{fields['Time']}")


def _complaint(fields: dict[str, str]) -> str:
    """Return what is wrong with a date and time; empty if nothing is."""
    try:
        local = _time_of(fields)
    except ValueError:
        return "write a date such as 2026-11-23 and a time such as 14:05"
    return "" if local.tzinfo is None else "write the time without a zone"


# The actions of the set-up screen, in the order of its list.

ActionName = Literal[
    "back",
    "facts",
    "pair",
    "test",
    "focus",
    "exposure",
    "zero",
    "check",
    "gel",
    "calibrations",
    "stick",
    "display",
    "brightness",
    "clock",
    "wifi",
    "off",
]


@dataclass(frozen=True, slots=True)
class SetupAction:
    """An action of the set-up screen: its title, and what it does."""

    name: ActionName
    title: str
    meaning: str


SETUP_ACTIONS: Final = (
    SetupAction("back", "Back to Scan", ""),
    SetupAction("facts", "This instrument", ""),
    SetupAction(
        "pair",
        "Pair",
        "A paired workstation may fetch scans.\nEnter opens a window for two minutes; "
        "the workstation and this screen then show a code to compare.",
    ),
    SetupAction(
        "test",
        "Self-test",
        "Tests every part, and each light through the camera.\nTouch nothing with the gel. Enter starts.",
    ),
    SetupAction(
        "focus",
        "Focus",
        "Shows how sharp the lens is set while you turn its focus ring.\n"
        "Lay a coin or print on the gel. Enter starts, and ends. Calibrate afterwards: the picture has changed.",
    ),
    SetupAction("exposure", "Exposure", ""),
    SetupAction(
        "zero",
        "Zero check",
        "Measures how flat the untouched skin reads: run it each morning, and when results look wrong.\n"
        "Touch nothing with the gel. Enter takes a frame; no scan is stored.",
    ),
    SetupAction("check", "Check standard", ""),
    SetupAction(
        "gel",
        "Change gel",
        "Select the mounted gel: its own calibration becomes active, or scans are refused until it has one.\n"
        "Enter lists the known gels.",
    ),
    SetupAction(
        "calibrations",
        "Calibrations",
        "All calibrations of this instrument are kept; any that matches can be activated again.\nEnter lists them.",
    ),
    SetupAction(
        "stick",
        "USB stick",
        "Copies every scan and calibration to the mounted USB stick, reads each back, and counts it as sent.\n"
        "retrosync pull fetches them from there. Enter starts.",
    ),
    SetupAction(
        "display",
        "Light display",
        "Black on white with strong colours, for the sun; or the dark screens again.\nEnter switches.",
    ),
    SetupAction("brightness", "Brightness", "Brightness of this panel. Enter goes to the next level."),
    SetupAction(
        "clock",
        "Clock",
        "A network sets the clock by itself. Without one, Enter sets date and time, or the time zone.",
    ),
    SetupAction(
        "wifi",
        "Wi-Fi",
        "A paired workstation fetches scans by any network. Enter looks for networks; choose one to join it.",
    ),
    SetupAction(
        "off",
        "Power off",
        "Stores running work, switches the lights off, and powers the instrument off.\nEnter asks first.",
    ),
)
