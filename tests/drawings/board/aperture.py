"""Blur at the skin of each board with a lens to choose, at any f-number."""

from __future__ import annotations

import msgspec

from hal.board_profile import load_board_profile
from hal.simulator.lens import Blur, blur_of

BOARDS = ("pi5-imx296", "pi4-imx477-binned")


def blur(board: str, f_number: float) -> Blur:
    """The blur of a board with the lens at an f-number, as engraved on it (for far objects)."""
    profile = load_board_profile(board)
    assert profile.lens is not None
    return blur_of(msgspec.structs.replace(profile.lens, f_number=f_number), profile.sensor.pixel_pitch_um)
