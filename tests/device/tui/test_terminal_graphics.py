"""Pictures to the pixel: what is written decodes to what was meant, and only for terminals that asked for it."""

import base64
import re

import cv2
import numpy as np
import pytest

from device.surface import HeightMap
from device.tui.screens.picture_viewer import INVALID, encoded, graphics_of, picture_text, relief_picture


@pytest.mark.parametrize(
    ("answer", "graphics"),
    [
        ("\x1b[?62;4;22c", "sixel"),
        ("\x1b[?63;1;2;4c", "sixel"),
        ("\x1b_Gi=31;OK\x1b\\\x1b[?62c", "kitty"),
        ("\x1b_Gi=31;EINVAL\x1b\\\x1b[?62c", None),
        ("\x1b[?1;2c", None),
        ("\x1b[?64;44c", None),
        ("\x1b[?4c", None),
        ("", None),
        ("garbage", None),
    ],
)
def test_a_terminal_is_taken_at_its_word(answer: str, graphics: str | None) -> None:
    assert graphics_of(answer) == graphics


def sixel_pixels(text: str) -> np.ndarray:
    """The picture that a sixel text draws, uint8 array of shape (h, w, 3)."""
    body = re.fullmatch(r'\x1bPq"1;1;(\d+);(\d+)(.*)\x1b[\\]', text)
    columns, rows, rest = int(body[1]), int(body[2]), body[3]
    picture = np.zeros((-(-rows // 6) * 6, columns, 3), np.uint8)
    palette: dict[int, list[int]] = {}
    row = column = colour = 0
    for token in re.finditer(r"#(\d+);2;(\d+);(\d+);(\d+)|#(\d+)|!(\d+)(.)|(\$)|(-)", rest):
        if token[1]:
            palette[int(token[1])] = [round(2.55 * int(token[part])) for part in (2, 3, 4)]
        elif token[5]:
            colour = int(token[5])
        elif token[6]:
            for bit in range(6):
                if (ord(token[7]) - 63) >> bit & 1:
                    picture[row + bit, column : column + int(token[6])] = palette[colour]
            column += int(token[6])
        elif token[8]:
            column = 0
        else:
            row, column = row + 6, 0
    return picture[:rows]


def test_sixels_draw_every_pixel_within_half_a_level_of_its_colour() -> None:
    random = np.random.default_rng(3)
    colours = random.integers(0, 256, (200, 3), dtype=np.uint8)
    picture = colours[random.integers(0, 200, (20, 31))]
    drawn = sixel_pixels(encoded(picture, "sixel"))
    assert drawn.shape == picture.shape
    assert np.abs(drawn.astype(int) - picture).max() <= 10


def test_more_colours_than_a_sixel_terminal_has_become_their_neighbours() -> None:
    picture = np.random.default_rng(5).integers(0, 256, (90, 90, 3), dtype=np.uint8)
    text = encoded(picture, "sixel")
    assert text.count(";2;") == 255
    assert np.abs(sixel_pixels(text).astype(int) - picture).mean() < 40


def test_kitty_gets_the_very_pixels_in_pieces() -> None:
    picture = np.random.default_rng(4).integers(0, 256, (60, 80, 3), dtype=np.uint8)
    pieces = re.findall(r"\x1b_G(?:a=T,f=100,)?m=(\d);([^\x1b]*)\x1b[\\]", encoded(picture, "kitty"))
    assert [more for more, _ in pieces] == ["1"] * (len(pieces) - 1) + ["0"]
    assert all(len(data) <= 4096 for _, data in pieces)
    png = np.frombuffer(base64.b64decode("".join(data for _, data in pieces)), np.uint8)
    assert (cv2.imdecode(png, cv2.IMREAD_COLOR)[..., ::-1] == picture).all()


def test_the_picture_says_its_scale_and_keeps_what_is_invalid_grey() -> None:
    z_um = np.tile(np.linspace(0.0, 120.0, 40, dtype=np.float32), (30, 1))
    z_um[:10, :10] = np.nan
    height = HeightMap(z_um, 50.0)
    assert (relief_picture(height)[5, 5] == INVALID).all()
    assert (relief_picture(height)[-5, -5] != INVALID).any()
    assert "2.0 x 1.5 mm; grey: not measured" in picture_text(height, "Quick look", "sixel")
