"""Colours of the screens: for a terminal with all colours, and for a plain console."""

from __future__ import annotations

from textual.theme import Theme

from device.tui.drawing.cells import ColourDepth


def theme_for(depth: ColourDepth) -> Theme:
    """The theme for a terminal's colours.

    Nothing depends on colour: chosen lines are reversed, important text is bold or has a word.
    """
    return _full() if depth == "full" else _sixteen()


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
