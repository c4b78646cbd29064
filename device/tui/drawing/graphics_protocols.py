"""Pixel graphics for terminals that support them: sixel and the kitty protocol."""

from __future__ import annotations

import base64
from typing import Final, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

Graphics = Literal["kitty", "sixel"]

KITTY_QUERY: Final = "\x1b_Gi=31,s=1,v=1,a=q,t=d,f=24;AAAA\x1b\\"
ATTRIBUTES_QUERY: Final = "\x1b[c"
"""Every terminal answers the second query; one with kitty graphics answers the first before it."""

_CHUNK: Final = 4096
_MAX_COLOURS: Final = 255
_LEVELS: Final = 16
"""Levels per channel from which the palette is chosen."""


def graphics_of(answer: str) -> Graphics | None:
    """The graphics protocol of a terminal, from its answer to both queries; None without one."""
    if "\x1b_Gi=31;OK" in answer:
        return "kitty"
    _, found, attributes = answer.rpartition("\x1b[?")
    return "sixel" if found and "4" in attributes.partition("c")[0].split(";")[1:] else None


def encoded(picture: NDArray[np.uint8], graphics: Graphics) -> str:
    """A picture, uint8 array of shape (h, w, 3), R, G, B, as the text that draws it on a terminal."""
    return _kitty(picture) if graphics == "kitty" else _sixel(picture)


def _kitty(picture: NDArray[np.uint8]) -> str:
    """A PNG in base64, in chunks of the protocol's maximum size."""
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
    """Bands of six rows, each with one line per colour in it."""
    rows, columns = picture.shape[:2]
    colours, place = _palette(picture)
    padded = np.full((-(-rows // 6) * 6, columns), -1, np.int32)
    padded[:rows] = place
    palette = "".join(_palette_entry(number, parts) for number, parts in enumerate(colours.tolist()))
    bands = "-".join(_band(band) for band in padded.reshape(-1, 6, columns))
    return f'\x1bPq"1;1;{columns};{rows}{palette}{bands}\x1b\\'


def _palette(picture: NDArray[np.uint8]) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """The most frequent colours as levels of shape (n, 3), and for each pixel the index of the nearest one."""
    level = (picture.astype(np.int32) * (_LEVELS - 1) + 127) // 255
    code = (level[..., 0] * _LEVELS + level[..., 1]) * _LEVELS + level[..., 2]
    present, place, count = np.unique(code, return_inverse=True, return_counts=True)
    kept = present[np.argsort(-count, kind="stable")[:_MAX_COLOURS]]
    here, there = _levels_of(present), _levels_of(kept)
    nearest = np.abs(here[:, np.newaxis] - there).sum(axis=-1).argmin(axis=1)
    return there, nearest.astype(np.int32)[place].reshape(code.shape)


def _levels_of(code: NDArray[np.int32]) -> NDArray[np.int32]:
    """Levels of red, green and blue, shape (n, 3)."""
    return np.stack([code // _LEVELS**2, code // _LEVELS % _LEVELS, code % _LEVELS], axis=-1)


def _palette_entry(number: int, levels: list[int]) -> str:
    """A palette entry with red, green and blue in per cent."""
    red, green, blue = (round(100 * level / (_LEVELS - 1)) for level in levels)
    return f"#{number};2;{red};{green};{blue}"


def _band(band: NDArray[np.int32]) -> str:
    """Six rows; each colour draws its pixels over the same band."""
    bits = (1 << np.arange(6, dtype=np.int32))[:, np.newaxis]
    lines = []
    for number in np.unique(band[band >= 0]).tolist():
        sixels = ((band == number) * bits).sum(axis=0)
        lines.append(f"#{number}" + _run_lengths(sixels))
    return "$".join(lines)


def _run_lengths(sixels: NDArray[np.int_]) -> str:
    """Runs of equal sixels as `!count` and a letter."""
    ends = [*(np.flatnonzero(np.diff(sixels)) + 1).tolist(), len(sixels)]
    starts = [0, *ends[:-1]]
    return "".join(f"!{end - start}{chr(63 + int(sixels[start]))}" for start, end in zip(starts, ends, strict=True))
