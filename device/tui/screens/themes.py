"""Colours of the screens: for a terminal with all colours, and for a plain console."""

from __future__ import annotations

from textual.theme import Theme

from device.store.choices import Display
from device.tui.drawing.cells import ColourDepth


def themes_for(depth: ColourDepth) -> dict[Display, Theme]:
    """Return the dark and the light theme for a terminal's colours; the light one is for the sun: black on white.

    Nothing depends on colour: chosen lines are reversed, important text is bold or has a word.
    """
    if depth == "full":
        return {"dark": _full(), "light": _full_light()}
    return {"dark": _sixteen(), "light": _sixteen_light()}


def _full_light() -> Theme:
    return Theme(
        name="retrograph-light",
        dark=False,
        primary="#003a70",
        secondary="#303030",
        accent="#7a3b00",
        success="#005a1e",
        warning="#7a3b00",
        error="#a00000",
        foreground="#000000",
        background="#ffffff",
        surface="#ffffff",
        panel="#e0e0e0",
        variables={"block-cursor-text-style": "bold", "input-cursor-text-style": "reverse"},
    )


def _sixteen_light() -> Theme:
    return Theme(
        name="retrograph-console-light",
        ansi=True,
        dark=False,
        primary="ansi_blue",
        secondary="ansi_black",
        accent="ansi_red",
        success="ansi_green",
        warning="ansi_red",
        error="ansi_red",
        foreground="ansi_black",
        background="ansi_white",
        surface="ansi_white",
        panel="ansi_white",
        boost="ansi_white",
        variables={
            "ansi-background": "ansi_white",
            "ansi-foreground": "ansi_black",
            "border": "ansi_black",
            "border-blurred": "ansi_black",
            "block-cursor-foreground": "ansi_black",
            "block-cursor-background": "ansi_white",
            "block-cursor-text-style": "reverse",
            "input-cursor-text-style": "reverse",
        },
    )


def _full() -> Theme:
    return Theme(
        name="retrograph",
        primary="#7fb8c9",
        secondary="#8a9ba8",
        accent="#e6c58a",
        success="#8fd0a0",
        warning="#e6c58a",
        error="#f0958a",
        foreground="#d5dce2",
        background="#0f1317",
        surface="#171d23",
        panel="#222b33",
        variables={"block-cursor-text-style": "bold", "input-cursor-text-style": "reverse"},
    )


def _sixteen() -> Theme:
    return Theme(
        name="retrograph-console",
        ansi=True,
        primary="ansi_cyan",
        secondary="ansi_white",
        accent="ansi_bright_yellow",
        success="ansi_bright_green",
        warning="ansi_bright_yellow",
        error="ansi_bright_red",
        foreground="ansi_default",
        background="ansi_default",
        surface="ansi_default",
        panel="ansi_default",
        boost="ansi_default",
        variables={
            "ansi-background": "ansi_black",
            "ansi-foreground": "ansi_white",
            "border": "ansi_white",
            "border-blurred": "ansi_white",
            "block-cursor-foreground": "ansi_default",
            "block-cursor-background": "ansi_default",
            "block-cursor-text-style": "reverse",
            "input-cursor-text-style": "reverse",
        },
    )
