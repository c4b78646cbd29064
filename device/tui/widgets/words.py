"""Words on a screen that are drawn only when they change: a state is shown ten times a second and rarely differs."""

from __future__ import annotations

from textual.content import Content
from textual.visual import VisualType
from textual.widgets import Static


class Words(Static):
    """A static text; parameters as for `Static`."""

    _said: tuple[object, ...] | None = None

    def update(self, content: VisualType = "", *, layout: bool = True) -> None:
        """Show other words; the same ones cost nothing."""
        said = (content.plain, *content.spans) if isinstance(content, Content) else (content,)
        if said != self._said:
            self._said = said
            super().update(content, layout=layout)
