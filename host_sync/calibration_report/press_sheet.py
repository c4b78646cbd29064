"""Pictures of presses side by side: where balls are, which are used, and why the others are not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from textwrap import wrap
from typing import Final

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.patches import Circle
from numpy.typing import NDArray

from device.balls.detector import RejectedBall
from device.balls.sphere import Ball
from host_sync.calibration.training_press import pictures_across

USED_COLOUR, REJECTED_COLOUR, GIVEN_COLOUR = "#ffffff", "#ffb000", "#40e0ff"
UNUSED_TITLE: Final = "#a03000"
TITLE_IN: Final = 0.38
_CHARACTERS_PER_INCH: Final = 15.0


@dataclass(frozen=True, slots=True, eq=False)
class ShownPress:
    """A press as a sheet shows it.

    shape : (H, W) of its frame
    picture : uint8 array of shape (h, w, 3); None where it could not be read
    words : what became of it, after its name
    given : circles that were drawn by hand and are used as they are
    """

    name: str
    shape: tuple[int, int]
    picture: NDArray[np.uint8] | None
    balls: tuple[Ball, ...]
    rejected: tuple[RejectedBall, ...]
    words: str
    given: tuple[Ball, ...] = ()

    @property
    def is_used(self) -> bool:
        """True if it shows a ball that is used."""
        return bool(self.balls or self.given)


def sheet_height_in(presses: Sequence[ShownPress], width_in: float) -> float:
    """Height of a sheet of these presses that is so wide."""
    across = pictures_across(len(presses))
    rows, columns = presses[0].shape
    return (width_in / across * rows / columns + TITLE_IN) * -(-len(presses) // across)


def draw_sheet(place: Figure | SubFigure, presses: Sequence[ShownPress], width_in: float, head_in: float) -> None:
    """Draw presses in rows under a head of `head_in`; a title says what became of each."""
    across = pictures_across(len(presses))
    rows, columns = presses[0].shape
    picture_in = width_in / across * rows / columns
    height_in = head_in + sheet_height_in(presses, width_in)
    # Set, not constrained: measuring every label takes longer than all else that is drawn here.
    margins = {"left": 0.005, "right": 0.995, "bottom": 0.005, "top": 1.0 - (head_in + TITLE_IN) / height_in}
    gaps = {"wspace": 0.03, "hspace": TITLE_IN / picture_in}
    count = -(-len(presses) // across)
    grid = place.subplots(count, across, squeeze=False, gridspec_kw=margins | gaps).ravel()
    for axes, press in zip(grid, presses, strict=False):
        _draw_press(axes, press, width_in / across)
    for axes in grid[len(presses) :]:
        axes.set_axis_off()


def _draw_press(axes: Axes, press: ShownPress, width_in: float) -> None:
    rows, columns = press.shape
    if press.picture is not None:
        axes.imshow(press.picture, extent=(-0.5, columns - 0.5, rows - 0.5, -0.5))
    for balls, colour in ((press.balls, USED_COLOUR), (press.given, GIVEN_COLOUR)):
        for ball in balls:
            axes.add_patch(Circle((ball.column, ball.row), ball.contact_radius_px, fill=False, color=colour, lw=1.2))
            axes.plot(ball.column, ball.row, "+", color=colour, ms=5, mew=1.0)
    for one in press.rejected:
        axes.plot(one.column, one.row, "x", color=REJECTED_COLOUR, ms=7, mew=1.6)
    axes.set_xlim(-0.5, columns - 0.5)
    axes.set_ylim(rows - 0.5, -0.5)
    wide = max(int(1.35 * _CHARACTERS_PER_INCH * width_in), 12)
    lines = [*wrap(press.name, wide)[:1], *wrap(press.words, wide)]
    text = "\n".join(lines[:3] if len(lines) <= 3 else [*lines[:2], lines[2][: wide - 1] + "…"])
    axes.set_title(text, fontsize=6, pad=2.0, color="black" if press.is_used else UNUSED_TITLE)
    axes.set_xticks([])
    axes.set_yticks([])


def reduced_picture(values: NDArray[np.floating], width_px: int) -> NDArray[np.uint8]:
    """Linear light as a picture of about this width: the brightest hundredth is white."""
    factor = max(1, values.shape[1] // width_px)
    size = (values.shape[1] // factor, values.shape[0] // factor)
    small = cv2.resize(np.asarray(values[..., :3], np.float32), size, interpolation=cv2.INTER_AREA)
    small = small if small.ndim == 3 else small[..., None].repeat(3, axis=-1)
    white = max(float(np.percentile(small, 99.0)), 1e-6)
    return np.asarray(np.rint(255.0 * np.clip(small / white, 0.0, 1.0) ** 0.45), np.uint8)
