"""What a terminal can show, from its environment; which glyphs a console's font holds is said in docs/screens.md."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, Literal

ColourDepth = Literal["full", "sixteen", "mono"]
"""Any colour; the sixteen of a plain console; none."""

_MONO: Final = ("", "dumb", "unknown", "vt100", "vt102", "vt220")


def colour_depth(environment: Mapping[str, str]) -> ColourDepth:
    """How many colours there are: none when NO_COLOR is set, sixteen where nothing promises more."""
    term = environment.get("TERM", "")
    if environment.get("NO_COLOR") or term in _MONO:
        return "mono"
    promised = environment.get("COLORTERM", "").lower() in {"truecolor", "24bit"}
    return "full" if promised or term.endswith("256color") or "kitty" in term else "sixteen"
