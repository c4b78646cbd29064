"""The line that says what happened last: what failed says so in a word, and stays until something else happens."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

from textual.content import Content
from textual.widgets import Static

Weight = Literal["told", "done", "failed"]

_SIGNS: Final[dict[Weight, str]] = {"told": "", "done": "", "failed": "! "}
_STYLES: Final[dict[Weight, str]] = {"told": "", "done": "$success", "failed": "$error bold"}


@dataclass(frozen=True, slots=True)
class Notice:
    """A sentence and its weight."""

    sentence: str
    weight: Weight = "told"


class NoticeLine(Static):
    """The last notice; an empty line while there is none, so that nothing jumps."""

    def show(self, notice: Notice | None) -> None:
        """Show a notice, or none."""
        text = Content.styled(_SIGNS[notice.weight] + notice.sentence, _STYLES[notice.weight]) if notice else ""
        self.update(text)
