"""The widget that shows the live picture with circles on it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from textual.events import Resize
from textual.geometry import Size
from textual.strip import Strip
from textual.widget import Widget

from device.tui.cells import Cells
from device.tui.frame_picture import Circle, frame_cells
from device.tui.height_picture import RoomForHeight, sentence_cells
from device.tui.resampling import fitted_shape
from device.tui.strips import strips
from device.tui.terminal import ColourDepth


class LiveView(Widget):
    """The live picture, or a sentence while there is none.

    Parameters
    ----------
    depth : the terminal's colours
    below : rows to keep free below, for what belongs to the picture
    """

    def __init__(self, depth: ColourDepth, below: int = 0, *, id: str | None = None) -> None:  # noqa: A002
        super().__init__(id=id)
        self._below = below
        self._depth: ColourDepth = depth
        self._picture: NDArray[np.uint8] | None = None
        self._circles: tuple[Circle, ...] = ()
        self._sentence = "Waiting for the camera."
        self._lines: list[Strip] | None = None

    def show(self, picture: NDArray[np.uint8] | None, circles: tuple[Circle, ...] = (), sentence: str = "") -> None:
        """Show a picture, uint8 array of shape (h, w, 3), and circles; or the sentence that says why there is none."""
        before, self._picture = self._picture, picture
        self._circles, self._sentence, self._lines = circles, sentence, None
        shapes = [None if shown is None else shown.shape for shown in (before, picture)]
        self.refresh(layout=shapes[0] != shapes[1])

    def get_content_height(self, container: Size, viewport: Size, width: int) -> int:  # noqa: ARG002
        """As high as the picture becomes, so that what stands below joins it."""
        rows = max(container.height - self._below, 1)
        return rows if self._picture is None else fitted_shape(self._picture.shape[:2], rows, max(width, 1))[0]

    def on_resize(self, _event: Resize) -> None:
        """Draw anew at the new size."""
        self._lines = None

    def render_line(self, y: int) -> Strip:
        """One row of the picture."""
        if self._lines is None:
            self._lines = strips(self._draw(), self.rich_style)
        return self._lines[y] if y < len(self._lines) else Strip.blank(self.size.width, self.rich_style)

    def _draw(self) -> Cells:
        rows, columns = self.size.height, self.size.width
        if self._picture is None:
            return sentence_cells(self._sentence, RoomForHeight(rows, columns, self._depth))
        picture = frame_cells(self._picture, max(rows, 1), max(columns, 1), self._depth, self._circles)
        cells = Cells.blank(rows, columns, self._depth)
        cells.paste(0, max((columns - picture.shape[1]) // 2, 0), picture)
        return cells
