"""Pixels that are not square, as frame sets and programs state them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from device.imaging.flat_field import LinearFrame
from host_sync import api
from host_sync.api_arguments import image_form, linear_frame, pitch_and_shape
from host_sync.errors import FrameSetError
from host_sync.frames.frame_set import load_frame_set
from host_sync.frames.image_info import square_frame
from host_sync.frames.linear_light import read_frame

TEXT = """
name = "stretched"
pixel_pitch_um = [PITCH]
encoding = "linear"
[[press]]
image = "press.png"
ball_radius_mm = 1.0
balls = [{ x = 59.5, y = 39.5, r = 20 }]
[[scan]]
name = "one"
image = "press.png"
"""


def disc(rows: int, columns: int) -> np.ndarray:
    """A disc that fills half of the field, whatever the pixels."""
    row, column = np.mgrid[:rows, :columns]
    inside = np.hypot((row + 0.5) / rows - 0.5, (column + 0.5) / columns - 0.5) < 0.25
    return np.dstack([np.where(inside, 200, 40)] * 3).astype(np.uint8)


@pytest.mark.parametrize(
    ("pitch", "shape", "square_um", "ball"),
    [
        ("20.0, 30.0", (80, 80), 30.0, (39.5, 39.5, 20 / 1.5)),
        ("30.0, 20.0", (53, 120), 30.0, (59.5, 26.0, 20 / 1.5)),
        ("20.0, 20.0", (80, 120), 20.0, (59.5, 39.5, 20.0)),
    ],
)
def test_frames_and_labels_become_square(
    tmp_path: Path, pitch: str, shape: tuple[int, int], square_um: float, ball: tuple[float, float, float]
) -> None:
    assert cv2.imwrite(str(tmp_path / "press.png"), disc(80, 120))
    path = tmp_path / "frameset.toml"
    path.write_text(TEXT.replace("PITCH", pitch))
    frame_set = load_frame_set(path)
    assert (frame_set.shape, frame_set.pixel_pitch_um) == (shape, square_um)
    (press,) = frame_set.presses
    assert press.radius_px == pytest.approx(1000.0 / square_um)
    assert press.balls is not None
    found = press.balls[0]
    assert (found.column, found.row, found.contact_radius_px) == pytest.approx(ball, abs=0.51)
    frame = read_frame(press.frame)
    assert frame.shape == shape
    assert frame.rgb == pytest.approx(disc(*shape) / 255.0, abs=0.7)
    assert float(frame.rgb.mean()) == pytest.approx(float(disc(80, 120).mean() / 255.0), rel=1e-3)
    as_array = linear_frame(disc(80, 120), image_form([], "linear", None, frame_set.pixel_shape))
    assert np.array_equal(as_array.rgb, frame.rgb)


@pytest.mark.parametrize("pitch", ["20.0", "20.0, 30.0, 40.0", "0.0, 20.0", '20.0, "x"'])
def test_what_is_no_pair_of_pitches_is_refused(tmp_path: Path, pitch: str) -> None:
    path = tmp_path / "frameset.toml"
    path.write_text(TEXT.replace("PITCH", pitch))
    with pytest.raises(FrameSetError, match="pixel_pitch_um"):
        load_frame_set(path)


def test_a_square_pixel_is_clipped_where_a_part_of_it_is() -> None:
    clipped = np.zeros((4, 4), np.bool_)
    clipped[1, 2] = True
    frame = LinearFrame(np.zeros((4, 4, 3), np.float32), clipped)
    assert np.argwhere(square_frame(frame, 2.0).clipped).tolist() == [[1, 1]]
    assert np.argwhere(square_frame(frame, 0.5).clipped).tolist() == [[0, 2]]


def test_a_program_states_two_pitches() -> None:
    assert pitch_and_shape((20.0, 25.0)) == (25.0, 1.25)
    assert pitch_and_shape(20.0) == (20.0, 1.0)
    for wrong in ((1.0, 2.0, 3.0), (1.0, -2.0), "x"):
        with pytest.raises(FrameSetError, match="pixel_pitch_um"):
            pitch_and_shape(wrong)
    with pytest.raises(FrameSetError, match="pixel_pitch_um"):
        api.calibrate([api.Press(disc(8, 8), 1.0)], pixel_pitch_um=(20.0, 0.0))
