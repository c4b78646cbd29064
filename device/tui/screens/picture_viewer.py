"""The relief in pixels, in a terminal with graphics: the screens are suspended until a key is pressed.

Why not within the screens: whatever redraws the cells under a picture destroys it, and terminals differ in how.
"""

from __future__ import annotations

import os
import select
import sys
import termios
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final, TextIO

import cv2
import numpy as np
from numpy.typing import NDArray

from device.surface.fields import HeightMap
from device.tui.drawing.graphics_protocols import ATTRIBUTES_QUERY, KITTY_QUERY, Graphics, encoded, graphics_of
from device.tui.drawing.legend import height_text
from device.tui.drawing.relief import HeightRange, height_colours, lit

MAX_VIEW_S: Final = 60.0
ANSWER_TIMEOUT_S: Final = 1.0
MAX_WIDTH_PX: Final = 760
INVALID: Final = (70, 70, 70)


Read = Callable[[float], str]


def view_picture(height: HeightMap, title: str, terminal: TextIO) -> bool:
    """Show a relief in the terminal until a key is pressed; False if the terminal has no graphics.

    The screens must be suspended, because this reads the terminal's answers and the key.
    """
    with _unbuffered(sys.stdin.fileno()) as read:
        terminal.write(KITTY_QUERY + ATTRIBUTES_QUERY)
        terminal.flush()
        graphics = graphics_of(_answer(read))
        if graphics is None:
            return False
        terminal.write(picture_text(height, title, graphics))
        terminal.flush()
        read(MAX_VIEW_S)
    terminal.write("\x1b[2J\x1b[H")
    terminal.flush()
    return True


def picture_text(height: HeightMap, title: str, graphics: Graphics) -> str:
    """The text that shows the relief on a cleared terminal, with its scale below."""
    rows, columns = height.z_um.shape
    heights = HeightRange.of(height.z_um)
    width_mm, height_mm = columns * height.pitch_um * 1e-3, rows * height.pitch_um * 1e-3
    words = (
        f"{title}: {height_text(heights.lowest_um)} µm (blue) to {height_text(heights.highest_um)} µm (sand), "
        f"{width_mm:.1f} x {height_mm:.1f} mm; grey: not measured"
    )
    return f"\x1b[2J\x1b[H{encoded(relief_picture(height), graphics)}\r\n{words}\r\nPress any key to return."


def relief_picture(height: HeightMap) -> NDArray[np.uint8]:
    """The shaded relief in colour: uint8 array of shape (h, w, 3), R, G, B; invalid pixels are grey."""
    heights = HeightRange.of(height.z_um)
    packed = height_colours(heights.fraction(height.z_um), 0.35 + 0.9 * lit(height.z_um, height.pitch_um))
    picture = np.stack([packed >> 16, packed >> 8 & 255, packed & 255], axis=-1).astype(np.uint8)
    picture[~np.isfinite(height.z_um)] = INVALID
    enlarged = max(MAX_WIDTH_PX // picture.shape[1], 1)
    size = (picture.shape[1] * enlarged, picture.shape[0] * enlarged)
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_NEAREST), np.uint8)


@contextmanager
def _unbuffered(descriptor: int) -> Iterator[Read]:
    """Unbuffered input without echo; restores the terminal afterwards."""
    before = termios.tcgetattr(descriptor)

    def read(timeout_s: float) -> str:
        ready = select.select([descriptor], [], [], timeout_s)[0]
        return os.read(descriptor, 1024).decode(errors="replace") if ready else ""

    try:
        tty.setcbreak(descriptor)
        yield read
    finally:
        termios.tcsetattr(descriptor, termios.TCSADRAIN, before)


def _answer(read: Read) -> str:
    """The terminal's answers up to the end of the last one."""
    answer = ""
    while not answer.endswith("c") and (more := read(ANSWER_TIMEOUT_S)):
        answer += more
    return answer
