"""The actions of the set-up screen, in the order of its list."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

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
