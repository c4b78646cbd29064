"""The relief in pixels, in a terminal with graphics: the screens are suspended until a key is pressed.

Why not within the screens: whatever redraws the cells under a picture destroys it, and terminals differ in how.
"""

from __future__ import annotations

import base64
import os
import select
import sys
import termios
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final, Literal, TextIO

import cv2
import numpy as np
from numpy.typing import NDArray

from device.surface import HeightMap
from device.tui.drawing.relief import HeightRange, height_colours, height_text, lit

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
    """Return the text that shows the relief on a cleared terminal, with its scale below."""
    rows, columns = height.z_um.shape
    heights = HeightRange.of(height.z_um)
    width_mm, height_mm = columns * height.pitch_um * 1e-3, rows * height.pitch_um * 1e-3
    words = (
        f"{title}: {height_text(heights.lowest_um)} µm (blue) to {height_text(heights.highest_um)} µm (sand), "
        f"{width_mm:.1f} x {height_mm:.1f} mm; grey: not measured"
    )
    return f"\x1b[2J\x1b[H{encoded(relief_picture(height), graphics)}\r\n{words}\r\nPress any key to return."


def relief_picture(height: HeightMap) -> NDArray[np.uint8]:
    """Return the shaded relief in colour: uint8 array of shape (h, w, 3), R, G, B; invalid pixels are grey."""
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
    """Return the terminal's answers up to the end of the last one."""
    answer = ""
    while not answer.endswith("c") and (more := read(ANSWER_TIMEOUT_S)):
        answer += more
    return answer


# Pixel graphics for terminals that support them: sixel and the kitty protocol.

Graphics = Literal["kitty", "sixel"]

KITTY_QUERY: Final = "\x1b_Gi=31,s=1,v=1,a=q,t=d,f=24;AAAA\x1b\\"
ATTRIBUTES_QUERY: Final = "\x1b[c"
"""Every terminal answers the second query; one with kitty graphics answers the first before it."""

_CHUNK: Final = 4096
_MAX_COLOURS: Final = 255
_LEVELS: Final = 16
"""Levels per channel from which the palette is chosen."""


def graphics_of(answer: str) -> Graphics | None:
    """Return the graphics protocol of a terminal, from its answer to both queries; None without one."""
    if "\x1b_Gi=31;OK" in answer:
        return "kitty"
    _, found, attributes = answer.rpartition("\x1b[?")
    return "sixel" if found and "4" in attributes.partition("c")[0].split(";")[1:] else None


def encoded(picture: NDArray[np.uint8], graphics: Graphics) -> str:
    """Return a picture, uint8 array of shape (h, w, 3), R, G, B, as the text that draws it on a terminal."""
    return _kitty(picture) if graphics == "kitty" else _sixel(picture)


def _kitty(picture: NDArray[np.uint8]) -> str:
    """Return a PNG in base64, in chunks of the protocol's maximum size."""
    png = cv2.imencode(".png", np.ascontiguousarray(picture[..., ::-1]))[1].tobytes()
    data = base64.b64encode(png).decode()
    pieces = [data[start : start + _CHUNK] for start in range(0, len(data), _CHUNK)]
    last = len(pieces) - 1
    heads = ["a=T,f=100," if number == 0 else "" for number in range(len(pieces))]
    return "".join(
        f"\x1b_G{head}m={int(number < last)};{piece}\x1b\\"
        for number, (head, piece) in enumerate(zip(heads, pieces, strict=True))
    )


def _sixel(picture: NDArray[np.uint8]) -> str:
    """Return bands of six rows, each with one line per colour in it."""
    rows, columns = picture.shape[:2]
    colours, place = _palette(picture)
    padded = np.full((-(-rows // 6) * 6, columns), -1, np.int32)
    padded[:rows] = place
    palette = "".join(_palette_entry(number, parts) for number, parts in enumerate(colours.tolist()))
    bands = "-".join(_band(band) for band in padded.reshape(-1, 6, columns))
    return f'\x1bPq"1;1;{columns};{rows}{palette}{bands}\x1b\\'


def _palette(picture: NDArray[np.uint8]) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return the most frequent colours as levels of shape (n, 3), and for each pixel the index of the nearest one."""
    level = (picture.astype(np.int32) * (_LEVELS - 1) + 127) // 255
    code = (level[..., 0] * _LEVELS + level[..., 1]) * _LEVELS + level[..., 2]
    present, place, count = np.unique(code, return_inverse=True, return_counts=True)
    kept = present[np.argsort(-count, kind="stable")[:_MAX_COLOURS]]
    here, there = _levels_of(present), _levels_of(kept)
    nearest = np.abs(here[:, np.newaxis] - there).sum(axis=-1).argmin(axis=1)
    return there, nearest.astype(np.int32)[place].reshape(code.shape)


def _levels_of(code: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return levels of red, green and blue, shape (n, 3)."""
    return np.stack([code // _LEVELS**2, code // _LEVELS % _LEVELS, code % _LEVELS], axis=-1)


def _palette_entry(number: int, levels: list[int]) -> str:
    """Return a palette entry with red, green and blue in per cent."""
    red, green, blue = (round(100 * level / (_LEVELS - 1)) for level in levels)
    return f"#{number};2;{red};{green};{blue}"


def _band(band: NDArray[np.int32]) -> str:
    """Return six rows; each colour draws its pixels over the same band."""
    bits = (1 << np.arange(6, dtype=np.int32))[:, np.newaxis]
    lines = []
    for number in np.unique(band[band >= 0]).tolist():
        sixels = ((band == number) * bits).sum(axis=0)
        lines.append(f"#{number}" + _run_lengths(sixels))
    return "$".join(lines)


def _run_lengths(sixels: NDArray[np.int_]) -> str:
    """Return runs of equal sixels as `!count` and a letter."""
    ends = [*(np.flatnonzero(np.diff(sixels)) + 1).tolist(), len(sixels)]
    starts = [0, *ends[:-1]]
    return "".join(f"!{end - start}{chr(63 + int(sixels[start]))}" for start, end in zip(starts, ends, strict=True))
