"""Frames of other than three lights: groups, hidden lights, contradicted ones, and surfaces of six against three."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from near_lamps import RADIUS_PX, SHAPE, balls, press_px

from device.errors import CalibrationError, CalibrationMismatch
from device.surface import GradientField
from host_sync.calibration.balls import PressFrame
from host_sync.calibration.calibrate import Calibration, calibrate
from host_sync.calibration.frames import CalibrationFrames, calibrate_lights
from host_sync.light_groups import choose_groups, in_group, joined
from host_sync.reconstruction.pipeline import reconstruct
from host_sync.results.typed_members import as_members, from_members
from tests.apparatus.light_ring import lit_by_ring

SIX = 6
PITCH_UM = 20.0


def presses(lights: int, each: int = 1) -> list[PressFrame]:
    """Frames of every ball, or of one in `each`."""
    return [
        PressFrame(
            f"press-{number:02d}",
            lit_by_ring(press_px(ball, apex), lights, number),
            RADIUS_PX,
        )
        for number, (ball, apex) in enumerate(balls()[::each])
    ]


def calibrated(lights: int, each: int = 1) -> Calibration:
    rest = lit_by_ring(np.zeros(SHAPE), lights, 99)
    return calibrate_lights(CalibrationFrames(tuple(presses(lights, each)), rest, PITCH_UM))


def slope_error(calibration: Calibration, lights: int) -> float:
    """Mean error of a fresh ball's slopes, of the surface."""
    ball = replace(balls()[5][0], column=170.0, row=120.0)
    z_px = press_px(ball, 15.0)
    result = reconstruct(lit_by_ring(z_px, lights, 200), calibration, "fresh")
    q, p = np.gradient(z_px)
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]]
    inside = np.hypot(column - ball.column, row - ball.row) < 0.85 * ball.contact_radius_px
    return float(np.hypot(result.p - p, result.q - q)[inside].mean())


@pytest.fixture(scope="module")
def six() -> Calibration:
    return calibrated(SIX)


@pytest.fixture(scope="module")
def few() -> Calibration:
    """Six lights, and as few balls as a quick test needs."""
    return calibrated(SIX, each=3)


def test_groups_hold_every_light_and_no_two_neighbours_only() -> None:
    for lights in range(3, 9):
        groups = choose_groups([press.frame for press in presses(lights)[:6]])
        assert {number for group in groups for number in group} == set(range(lights))
        assert all(len(set(group)) == 3 for group in groups)
    assert sorted(map(sorted, choose_groups([press.frame for press in presses(6)[:6]]))) == [[0, 2, 4], [1, 3, 5]]


def test_nine_lights_are_refused() -> None:
    with pytest.raises(CalibrationError, match="9 lights are more than 8"):
        choose_groups([lit_by_ring(np.zeros(SHAPE), 9, 0)])


def test_frames_of_different_numbers_of_lights_are_refused() -> None:
    with pytest.raises(CalibrationError, match="different numbers of lights"):
        calibrate_lights(CalibrationFrames(tuple(presses(4)[:2]), lit_by_ring(np.zeros(SHAPE), 5, 0), PITCH_UM))


@pytest.mark.slow
def test_six_lights_are_nearer_the_truth_than_three(six: Calibration) -> None:
    ordinary = calibrated(3)
    assert ordinary.lights is None
    assert slope_error(six, SIX) < 0.8 * slope_error(ordinary, 3)


@pytest.mark.slow
def test_the_error_of_six_lights_is_that_of_both_groups_together(six: Calibration) -> None:
    presses_of_six = presses(SIX)
    assert six.lights is not None
    group = six.lights.groups[0]
    own = [replace(press, frame=in_group(press.frame, group)) for press in presses_of_six]
    first = calibrate(own, in_group(lit_by_ring(np.zeros(SHAPE), SIX, 99), group), PITCH_UM).slope_error
    shares = np.array(six.slope_error.pixel_deg) / first.pixel_deg
    assert np.all(shares < 0.85)  # independent noise of two groups: 0.71
    assert np.all(shares > 0.55)
    assert six.slope_error.tilt_deg == first.tilt_deg


@pytest.mark.slow
def test_three_lights_take_the_path_of_an_rgb_frame_bit_for_bit() -> None:
    rest = lit_by_ring(np.zeros(SHAPE), 3, 99)
    by_lights = calibrate_lights(CalibrationFrames(tuple(presses(3)), rest, PITCH_UM))
    alone = calibrate(presses(3), rest, PITCH_UM)
    assert by_lights.calibration_id == alone.calibration_id
    assert by_lights.lights is None
    frame = lit_by_ring(press_px(*balls()[0]), 3, 300)
    found, wanted = (reconstruct(frame, calibration, "scan") for calibration in (by_lights, alone))
    for one, other in ((found.height.z_um, wanted.height.z_um), (found.sigma_um, wanted.sigma_um), (found.p, wanted.p)):
        assert one.tobytes() == other.tobytes()


def test_a_calibration_of_six_lights_is_read_back_as_it_was_written(few: Calibration) -> None:
    again = from_members(as_members(few), Calibration)
    assert again.lights is not None
    assert again.lights.groups == few.lights.groups
    assert slope_error(again, SIX) == slope_error(few, SIX)


def test_a_frame_of_other_lights_is_refused(few: Calibration) -> None:
    with pytest.raises(CalibrationMismatch, match="shows 3 lights and its calibration 6"):
        reconstruct(lit_by_ring(np.zeros(SHAPE), 3, 0), few, "scan")


def test_a_dim_light_is_named(few: Calibration) -> None:
    frame = lit_by_ring(press_px(*balls()[0]), SIX, 300)
    frame.rgb[..., 3] *= 0.9
    with pytest.raises(CalibrationMismatch, match=r"light 4 is .* darker than the others predict"):
        reconstruct(frame, few, "scan")


def test_images_in_another_order_are_refused(few: Calibration) -> None:
    frame = lit_by_ring(press_px(*balls()[0]), SIX, 300)
    with pytest.raises(CalibrationMismatch, match="not made as its calibration was"):
        reconstruct(replace(frame, rgb=np.ascontiguousarray(frame.rgb[..., [1, 0, 2, 3, 4, 5]])), few, "scan")


def test_a_light_that_is_hidden_somewhere_is_left_out_there(few: Calibration) -> None:
    frame = lit_by_ring(np.zeros(SHAPE), SIX, 301)
    hidden = (slice(100, 140), slice(150, 200))
    frame.rgb[(*hidden, 2)] *= 0.1
    masks = few.lights.left_out(frame)
    for group, mask in zip(few.lights.groups, masks, strict=True):
        share = mask[104:136, 154:196].mean()
        assert share > 0.95 if 2 in group else share < 0.05
        assert mask[:80].mean() < 0.05
    result = reconstruct(frame, few, "scan", force=True)
    assert np.hypot(result.gradients.p, result.gradients.q)[104:136, 154:196].mean() < 0.02


def test_a_group_with_a_hidden_light_counts_only_where_no_other_is_left() -> None:
    ones, full = np.ones((2, 2), np.float32), np.ones((2, 2), bool)
    fields = [GradientField(value * ones, value * ones, full, ones) for value in (0.0, 1.0)]
    nowhere, everywhere = np.zeros((2, 2), bool), np.ones((2, 2), bool)
    assert np.allclose(joined(fields, [nowhere, nowhere]).p, 0.5)
    assert np.all(joined(fields, [everywhere, nowhere]).p > 0.97)
    assert np.allclose(joined(fields, [everywhere, everywhere]).p, 0.5)


@pytest.mark.slow
@pytest.mark.parametrize("lights", [4, 5, 7, 8])
def test_any_number_of_lights_gives_a_surface(lights: int) -> None:
    assert slope_error(calibrated(lights), lights) < 0.03


@pytest.mark.parametrize("lights", [1, 2])
def test_too_few_lights_for_two_slopes_are_refused(lights: int) -> None:
    with pytest.raises(CalibrationError, match="too few lights"):
        calibrated(lights)
