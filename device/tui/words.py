"""Numbers and states in the few words that a screen has room for."""

from __future__ import annotations

import textwrap
from typing import Final

from device.scan_bundle import Annotations, VerdictLevel

GAUGE_FULL: Final = "■"
GAUGE_EMPTY: Final = "·"

_LEVELS: Final[dict[VerdictLevel, str]] = {"good": "GOOD", "doubtful": "DOUBTFUL", "retake": "RETAKE"}
_MINUTE, _HOUR, _DAY = 60.0, 3600.0, 86400.0


def verdict_word(level: VerdictLevel) -> str:
    """A verdict's level as it is shouted."""
    return _LEVELS[level]


def age_text(age_s: float) -> str:
    """An age such as "3 h ago"."""
    if age_s < _MINUTE:
        return "just now"
    if age_s < _HOUR:
        return f"{int(age_s // _MINUTE)} min ago"
    return f"{int(age_s // _HOUR)} h ago" if age_s < 2 * _DAY else f"{int(age_s // _DAY)} days ago"


def share_text(share: float | None) -> str:
    """A share in per cent; a dash where nothing was measured."""
    return "-" if share is None else f"{share:.0%}"


def gauge_text(name: str, share: float | None, columns: int, words: str | None = None) -> str:
    """A name, a bar and a number in so many columns, such as "contact ■■■■····  52%"; `words` in the number's place."""
    label, number = f"{name:<9}", f"{words or share_text(share):>6}"
    room = columns - len(label) - len(number)
    if room < 3:
        return (label + number)[:columns].ljust(columns)
    filled = 0 if share is None else round(min(max(share, 0.0), 1.0) * room)
    return f"{label}{GAUGE_FULL * filled}{GAUGE_EMPTY * (room - filled)}{number}"


def sticky_text(sticky: Annotations) -> str:
    """Job, part and operator in a line; a dash for what is not set."""
    return f"Job {sticky.job or '-'} · Part {sticky.part or '-'} · Operator {sticky.operator or '-'}"


def hanging(text: str, columns: int, indent: int) -> str:
    """The text in lines of so many columns, all but the first of them indented."""
    wrapped = textwrap.wrap(text, max(columns, indent + 8), subsequent_indent=" " * indent, drop_whitespace=True)
    return "\n".join(wrapped) or text


def shortened(text: str, columns: int) -> str:
    """The text, or as much of it as fits, with an ellipsis."""
    return text if len(text) <= columns else text[: max(columns - 1, 0)] + "…"
