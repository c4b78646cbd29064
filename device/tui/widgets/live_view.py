"""The widget that shows the live picture with circles on it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from textual.geometry import Size

from device.surface.fields import Float32Array
from device.tui.drawing.cells import CellGrid, ColourDepth
from device.tui.drawing.frame_picture import Circle, frame_cells, shown_colours
from device.tui.drawing.height_picture import Room, sentence_cells
from device.tui.drawing.resampling import fitted_shape
from device.tui.widgets.cells_view import CellsView


class LiveView(CellsView):
    """The live picture, or a sentence without one; parameters as for `CellsView`."""

    def __init__(self, depth: ColourDepth, below: int = 0, *, id: str | None = None) -> None:  # noqa: A002
        super().__init__(depth, below, id=id)
        self._picture: NDArray[np.uint8] | None = None
        self._circles: tuple[Circle, ...] = ()
        self._colours: Float32Array | None = None
        self._sentence = "Waiting for the camera."

    def show(self, picture: NDArray[np.uint8] | None, circles: tuple[Circle, ...] = (), sentence: str = "") -> None:
        """Show a picture, uint8 array of shape (h, w, 3), with circles; or the sentence that says why it is missing."""
        if (picture is self._picture, circles, sentence) == (True, self._circles, self._sentence):
            return
        before, self._picture = self._picture, picture
        self._circles, self._sentence = circles, sentence
        shapes = [None if shown is None else shown.shape for shown in (before, picture)]
        if picture is None or shapes[0] != shapes[1]:
            self._colours = None
            self.redraw(layout=shapes[0] != shapes[1])
        else:
            self.redraw_changes()

    def get_content_height(self, container: Size, viewport: Size, width: int) -> int:  # noqa: ARG002
        """The picture's height, so that the next widget follows directly."""
        rows = max(container.height - self._below, 1)
        return rows if self._picture is None else fitted_shape(self._picture.shape[:2], rows, max(width, 1))[0]

    def draw(self, room: Room) -> CellGrid:
        """The picture centred in the room, or the sentence."""
        if self._picture is None:
            return sentence_cells(self._sentence, room)
        self._colours = shown_colours(self._picture, max(room.rows, 1), max(room.columns, 1), self._colours)
        picture = frame_cells(self._colours, room.depth, self._circles)
        cells = CellGrid.empty(room.rows, room.columns, room.depth)
        cells.blit(0, max((room.columns - picture.shape[1]) // 2, 0), picture)
        return cells
