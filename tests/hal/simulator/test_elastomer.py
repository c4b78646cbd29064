import numpy as np
import pytest
from scipy.special import k0, k1

from hal.simulator.elastomer import ball_indentation_mm, decay_length_mm, drape
from hal.simulator.surfaces import Block, FloatArray, Groove, Sphere

PITCH_MM = 0.04
THICKNESS_MM = 2.5


def grid(rows: int = 327, columns: int = 437) -> tuple[FloatArray, FloatArray]:
    y, x = np.mgrid[:rows, :columns].astype(np.float32) * np.float32(PITCH_MM)
    return x - x.mean(), y - y.mean()


def test_a_ball_is_met_by_the_closed_form() -> None:
    """Sphere within the contact, K0 outside, the same slope on both sides of the rim."""
    x, y = grid()
    radius_mm, rim_rad = 3.0, np.radians(40.0)
    depth_mm = ball_indentation_mm(radius_mm, rim_rad, THICKNESS_MM)
    skin = drape(Sphere(radius_mm).height_mm(x, y) + depth_mm, PITCH_MM, THICKNESS_MM)
    length, rim_mm = decay_length_mm(THICKNESS_MM), radius_mm * np.sin(rim_rad)
    at_rim = depth_mm - radius_mm * (1.0 - np.cos(rim_rad))
    assert at_rim / length * k1(rim_mm / length) / k0(rim_mm / length) == pytest.approx(np.tan(rim_rad))
    far = np.hypot(x, y).astype(np.float64)
    cap = np.sqrt(np.maximum(radius_mm**2 - far**2, 0.0)) - radius_mm + depth_mm
    fading = at_rim * k0(np.maximum(far, rim_mm) / length) / k0(rim_mm / length)
    expected = np.where(far <= rim_mm, cap, fading)
    assert np.abs(skin.height_mm - expected).max() < 0.004
    assert np.sqrt(skin.contact.sum() / np.pi) * PITCH_MM == pytest.approx(rim_mm, abs=0.5 * PITCH_MM)
    slopes = [np.hypot(*np.gradient(z / PITCH_MM)) for z in (skin.height_mm.astype(np.float64), expected)]
    assert np.abs(slopes[0] - slopes[1]).max() < 0.02


def test_skin_and_object_complement_each_other() -> None:
    """Never below the object, never pulled: forces where it touches, free elsewhere."""
    x, y = grid()
    block = Groove(Block(4.0, 3.0), 0.8, 0.2, 0.12).height_mm(x, y) + 0.5
    skin = drape(block, PITCH_MM, THICKNESS_MM)
    height = skin.height_mm.astype(np.float64)
    assert (height >= np.nan_to_num(block, nan=-1.0)).all()
    padded = np.pad(height, 1, mode="edge")
    bend = padded[:-2, 1:-1] + padded[2:, 1:-1] + padded[1:-1, :-2] + padded[1:-1, 2:] - 4.0 * height
    push = height - (decay_length_mm(THICKNESS_MM) / PITCH_MM) ** 2 * bend
    assert push[skin.contact].min() > -1e-2
    assert np.abs(push[~skin.contact]).max() < 2e-2 * push.max()
    np.testing.assert_array_equal(height[skin.contact], block[skin.contact])


def test_it_bridges_a_narrow_groove_and_sinks_into_a_wide_one() -> None:
    x, y = grid()
    left = []
    for width_mm in (0.3, 3.0):
        block = Groove(Block(4.0, 3.0), width_mm, 0.1, 0.12).height_mm(x, y) + 0.5
        skin = drape(block, PITCH_MM, THICKNESS_MM)
        middle = skin.height_mm[np.abs(y) < 0.1][np.abs(x[np.abs(y) < 0.1]) < 0.05]
        left.append(float(0.5 - middle.mean()))
    # A gap of 0.54 mm between the shoulders sags by about gap² z / 8 L².
    assert left[0] == pytest.approx(0.54**2 * 0.5 / 8.0 / decay_length_mm(THICKNESS_MM) ** 2, rel=0.1)
    assert left[1] > 0.08


def test_the_contact_is_symmetric_where_the_object_is() -> None:
    x, y = grid(301, 301)
    skin = drape(Sphere(2.0).height_mm(x, y) + 0.5, PITCH_MM, THICKNESS_MM)
    np.testing.assert_allclose(skin.height_mm, skin.height_mm.T, atol=1e-5)
    np.testing.assert_allclose(skin.height_mm, skin.height_mm[::-1, ::-1], atol=1e-4)


def test_resolution_does_not_change_the_answer() -> None:
    heights = []
    for factor in (1, 2, 4):
        y, x = np.mgrid[: 272 // factor, : 364 // factor].astype(np.float32)
        pitch = 0.048 * factor
        x, y = ((a - a.mean()) * np.float32(pitch) for a in (x, y))
        skin = drape(Sphere(3.0).height_mm(x, y) + 1.2, pitch, THICKNESS_MM).height_mm
        heights.append(skin.reshape(68, 4 // factor, 91, 4 // factor).mean(axis=(1, 3)))
    assert np.abs(heights[0] - heights[1]).max() < 0.01
    assert np.abs(heights[0] - heights[2]).max() < 0.03


def test_nothing_pressed_leaves_the_skin_at_rest() -> None:
    skin = drape(np.full((120, 90), np.nan), PITCH_MM, THICKNESS_MM)
    assert not skin.contact.any()
    assert not skin.height_mm.any()
