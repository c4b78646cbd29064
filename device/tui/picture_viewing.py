"""The relief to the pixel, in a terminal that can draw pictures: the screens step aside until a key is pressed.

Why beside the screens and not in them: a picture among cells is lost by whatever redraws those cells, and terminals
differ in how. On a terminal that shows nothing but pictures and a line of text there is nothing to go wrong.
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

from device.surface import HeightMap
from device.tui.colour_map import height_colours
from device.tui.relief import HeightRange, lit
from device.tui.scale import height_text
from device.tui.terminal_graphics import ATTRIBUTES_QUERY, KITTY_QUERY, Graphics, encoded, graphics_of

LONGEST_LOOK_S: Final = 60.0
ANSWER_S: Final = 1.0
WIDEST_PX: Final = 760
INVALID: Final = (70, 70, 70)


def view_picture(height: HeightMap, title: str, terminal: TextIO) -> bool:
    """Show a relief in the terminal until a key is pressed; False when the terminal has cells only.

    The screens must be suspended: this reads the terminal's answers and the key.
    """
    with _unbuffered(sys.stdin.fileno()) as read:
        terminal.write(KITTY_QUERY + ATTRIBUTES_QUERY)
        terminal.flush()
        graphics = graphics_of(_answer(read))
        if graphics is None:
            return False
        terminal.write(picture_text(height, title, graphics))
        terminal.flush()
        read(LONGEST_LOOK_S)
    terminal.write("\x1b[2J\x1b[H")
    terminal.flush()
    return True


def picture_text(height: HeightMap, title: str, graphics: Graphics) -> str:
    """What shows the relief on a cleared terminal, with its scale in words below."""
    rows, columns = height.z_um.shape
    heights = HeightRange.of(height.z_um)
    width_mm, height_mm = columns * height.pitch_um * 1e-3, rows * height.pitch_um * 1e-3
    words = (
        f"{title}: {height_text(heights.lowest_um)} µm (blue) to {height_text(heights.highest_um)} µm (sand), "
        f"{width_mm:.1f} x {height_mm:.1f} mm; grey: not measured"
    )
    return f"\x1b[2J\x1b[H{encoded(relief_picture(height), graphics)}\r\n{words}\r\nAny key goes back."


def relief_picture(height: HeightMap) -> NDArray[np.uint8]:
    """The shaded relief in colour, uint8 array of shape (h, w, 3), R, G, B; invalid pixels plain grey."""
    heights = HeightRange.of(height.z_um)
    packed = height_colours(heights.share(height.z_um), 0.35 + 0.9 * lit(height.z_um, height.pitch_um))
    picture = np.stack([packed >> 16, packed >> 8 & 255, packed & 255], axis=-1).astype(np.uint8)
    picture[~np.isfinite(height.z_um)] = INVALID
    enlarged = max(WIDEST_PX // picture.shape[1], 1)
    size = (picture.shape[1] * enlarged, picture.shape[0] * enlarged)
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_NEAREST), np.uint8)


Read = Callable[[float], str]


@contextmanager
def _unbuffered(descriptor: int) -> Iterator[Read]:
    """Keys as they come, unseen; the terminal is as before afterwards."""
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
    """Everything up to the end of the answer that every terminal gives."""
    answer = ""
    while not answer.endswith("c") and (more := read(ANSWER_S)):
        answer += more
    return answer
