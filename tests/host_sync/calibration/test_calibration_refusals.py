"""Presses of the twin that do not carry a calibration, refused with the number; grids that measure their own pitch."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace

import msgspec
import numpy as np
import pytest

from device.acquisition.capture import CaptureSettings, capture
from device.balls.detector import BallSearch, find_balls
from device.balls.sphere import gather_samples
from device.calibration.fit import CORE_FRACTION
from device.errors import CalibrationError, CalibrationMismatch, FrameError
from device.imaging.flat_field import (
    SATURATED,
    LinearFrame,
    NormalizedImage,
    demosaic,
    flat_field_correct,
    make_flat_field,
)
from device.inverse_map.near_light import IlluminationMap
from hal.board_profile import BoardProfile
from hal.clock import VirtualClock
from hal.interfaces import LiftOff, PressBall
from hal.simulator.bench import build
from hal.simulator.hardware import twin_hardware
from hal.simulator.scene import Press
from hal.simulator.surfaces import SphereGrid
from host_sync.calibration.balls import GridSpacing, PressFrame, check_distinct, locate
from host_sync.calibration.calibrate import calibrate
from host_sync.calibration.consistency import check_agreement
from host_sync.calibration.located_presses import detect_grid
from host_sync.calibration.radii import (
    FittingRadius,
    check_radii,
    contradicts,
    fit_to,
    left_out,
    radius_shares,
    radius_spread,
)

PITCH_UM = 48.0
RADIUS_MM = 3.0
PLACES = [(column, row) for row in (0.25, 0.75) for column in (0.2, 0.5, 0.8)]
RADIUS_PX = RADIUS_MM * 1e3 / PITCH_UM
WIDE = (1.0, 1.2)
GRID_RADIUS_MM, GRID_PITCH_MM, GRID_DEPTH_MM = 1.0, 2.5, 0.45


@dataclass(frozen=True)
class SimulatedScene:
    """Frames of one board: the untouched skin, and single balls all over it."""

    rest: LinearFrame
    balls: tuple[LinearFrame, ...]


@dataclass(frozen=True)
class OddGrid:
    """A grid one ball of which stands off its place."""

    def height_mm(self, x_mm: np.ndarray, y_mm: np.ndarray) -> np.ndarray:
        x_mm, y_mm = np.broadcast_arrays(x_mm, y_mm)
        grid = SphereGrid(GRID_RADIUS_MM, GRID_PITCH_MM, 2).height_mm(x_mm, y_mm)
        own_cell = np.hypot(x_mm - GRID_PITCH_MM, y_mm) < 0.5 * GRID_PITCH_MM
        moved = SphereGrid(GRID_RADIUS_MM, GRID_PITCH_MM, 0).height_mm(x_mm - 0.8 * GRID_PITCH_MM, y_mm)
        return np.where(own_cell, moved, grid)


def shoot(profile: BoardProfile, radius_mm: float = RADIUS_MM) -> SimulatedScene:
    frames = []
    with twin_hardware(build(profile, VirtualClock())) as hardware:
        for request in [LiftOff(), *(PressBall(radius_mm, column, row) for column, row in PLACES)]:
            hardware.operator.ask(request)
            hardware.button.wait_for_press(None)
            frames.append(demosaic(capture(hardware, CaptureSettings.of_board(hardware))))
    return SimulatedScene(frames[0], tuple(frames[1:]))


def shoot_grid(profile: BoardProfile, surface: SphereGrid | OddGrid) -> LinearFrame:
    bench = build(profile, VirtualClock())
    with twin_hardware(bench) as hardware:
        bench.place(Press(surface, (0.3, -0.2), 0.06, GRID_DEPTH_MM))
        return demosaic(capture(hardware, CaptureSettings.of_board(hardware)))


@pytest.fixture(scope="module")
def usual(small_twin: BoardProfile) -> SimulatedScene:
    return shoot(small_twin)


@pytest.fixture(scope="module")
def turned(small_twin: BoardProfile) -> SimulatedScene:
    """The same gel, its lights turned by 40 degrees."""
    cos, sin = np.cos(np.radians(40.0)), np.sin(np.radians(40.0))
    lights = tuple(
        msgspec.structs.replace(light, position_mm=(float(cos * x - sin * y), float(sin * x + cos * y), z))
        for light in small_twin.lights
        for x, y, z in [light.position_mm]
    )
    return shoot(msgspec.structs.replace(small_twin, lights=lights))


def presses(frames: Sequence[LinearFrame], pitch_um: float = PITCH_UM) -> list[PressFrame]:
    return [PressFrame(f"press-{i:02d}", frame, RADIUS_MM * 1e3 / pitch_um) for i, frame in enumerate(frames)]


def brighter(frame: LinearFrame, factor: float) -> LinearFrame:
    rgb = np.minimum(frame.rgb * np.float32(factor), np.float32(1.0))
    return LinearFrame(rgb, (rgb >= SATURATED).any(axis=-1))


def grid_press(frame: LinearFrame, pitch_um: float = PITCH_UM) -> PressFrame:
    return PressFrame("grid", frame, GRID_RADIUS_MM * 1e3 / pitch_um, grid=GridSpacing(GRID_PITCH_MM))


def test_too_few_balls_are_counted(usual: SimulatedScene) -> None:
    frames = [*usual.balls[:2], usual.rest]
    with pytest.raises(CalibrationError, match=r"2 usable balls in 3 .*press-02 shows no ball .*and 4 are needed"):
        calibrate(presses(frames), usual.rest, PITCH_UM)


def test_one_press_under_two_names_is_refused(usual: SimulatedScene) -> None:
    frames = [*usual.balls, replace(usual.balls[2], rgb=usual.balls[2].rgb.copy())]
    with pytest.raises(CalibrationError, match=r"press-06 is the same frame as press-02: leave one out"):
        calibrate(presses(frames), usual.rest, PITCH_UM)


def test_one_ball_in_two_labels_of_one_frame_is_refused(usual: SimulatedScene) -> None:
    found = [replace(press, balls=locate(press, usual.rest.rgb).balls) for press in presses(usual.balls)]
    (ball,) = found[2].balls or ()
    again = replace(found[2], name="press-06", balls=(replace(ball, column=ball.column + 2.0),))
    with pytest.raises(CalibrationError, match=r"press-06 is the same frame as press-02"):
        check_distinct([*found, again])
    check_distinct([*found, replace(again, balls=(replace(ball, column=ball.column + 3 * ball.contact_radius_px),))])


@pytest.mark.slow
def test_another_radius_is_hinted_where_many_presses_show_nothing(usual: SimulatedScene) -> None:
    empty = [replace(usual.rest, rgb=np.roll(usual.rest.rgb, i + 1, axis=0)) for i in range(4)]
    small = [replace(press, radius_px=0.3 * press.radius_px) for press in presses([*usual.balls[:3], *empty])]
    with pytest.raises(CalibrationError, match=r"usable balls in 7 .* fits the balls .*: check ball_radius_mm"):
        calibrate(small, usual.rest, PITCH_UM)


def test_a_reference_of_another_gel_is_refused(usual: SimulatedScene, small_twin: BoardProfile) -> None:
    twin = small_twin.twin
    assert twin is not None
    other = msgspec.structs.replace(small_twin, twin=msgspec.structs.replace(twin, skin="flake"))
    with pytest.raises(CalibrationMismatch, match=r"reference is not of these presses: .* is \d\d% off it"):
        calibrate(presses(usual.balls), shoot(other).rest, PITCH_UM)


@pytest.mark.parametrize("with_reference", [True, False])
def test_two_sets_of_lights_are_distinguished(
    usual: SimulatedScene, turned: SimulatedScene, with_reference: bool
) -> None:
    mixed = [*usual.balls[:4], *turned.balls[4:]]
    with pytest.raises(CalibrationMismatch, match=r"mixed: untouched skin of press-04, press-05 is \d\d% off"):
        calibrate(presses(mixed), usual.rest if with_reference else None, PITCH_UM)


def test_a_clipped_reference_and_clipped_balls_are_refused(usual: SimulatedScene) -> None:
    with pytest.raises(FrameError, match=r"reference is saturated over \d\d% of its area, at most 10% may be"):
        calibrate(presses([brighter(frame, 2.0) for frame in usual.balls]), brighter(usual.rest, 2.0), PITCH_UM)
    row, column = np.mgrid[: usual.rest.shape[0], : usual.rest.shape[1]]
    clipped = []
    for frame, (across, down) in zip(usual.balls, PLACES, strict=True):
        away = np.hypot(column - across * usual.rest.shape[1], row - down * usual.rest.shape[0])
        clipped.append(replace(frame, clipped=away < RADIUS_MM * 1e3 / PITCH_UM))
    with pytest.raises(CalibrationError, match=r"0 usable balls .*\d\d% of its contact is saturated .* 4 are needed"):
        calibrate(presses(clipped), usual.rest, PITCH_UM)


@pytest.mark.slow
def test_contradictory_radii_are_refused_with_what_they_read(usual: SimulatedScene, small_twin: BoardProfile) -> None:
    smaller = shoot(small_twin, radius_mm=2.0)
    mixed = [*usual.balls[::2], *smaller.balls[1::2]]
    with pytest.raises(CalibrationError, match=r"radii contradict .* 0\.\d\d \(press-0\d\) to 1\.\d\d \(press-"):
        calibrate(presses(mixed), usual.rest, PITCH_UM)


@pytest.mark.slow
def test_a_press_whose_radius_contradicts_the_others_is_left_out_by_name(
    usual: SimulatedScene, small_twin: BoardProfile
) -> None:
    odd = shoot(small_twin, radius_mm=2.0).balls[2]
    calibration = calibrate([*presses(usual.balls), replace(presses([odd])[0], name="odd")], usual.rest, PITCH_UM)
    assert [press.name for press in calibration.presses if not press.balls] == ["odd"]
    (note,) = [note for note in calibration.assessment.notes if note.startswith("odd ")]
    assert "it is not used" in note


def test_only_balls_that_stand_out_of_the_others_contradict_them() -> None:
    scattered = np.array([0.94, 0.96, 0.97, 0.98, 1.0, 1.01, 1.02, 1.05, 1.09, 1.12, 1.17, 1.37])
    assert contradicts(scattered).nonzero()[0].tolist() == [11]
    assert contradicts(1.05 * np.array([1.0, 1.0, 1.01, 0.99, 0.8, 1.0])).nonzero()[0].tolist() == [4]
    assert not contradicts(np.array([0.7, 0.7, 0.7, 1.3, 1.3, 1.3])).any()


@pytest.mark.slow
def test_contacts_that_reach_beyond_the_ball_are_cut_to_their_core(usual: SimulatedScene) -> None:
    flat_field = make_flat_field(usual.rest)
    found = [find_balls(flat_field_correct(frame, flat_field), RADIUS_PX).found[0] for frame in usual.balls]
    given = [replace(ball, contact_radius_px=WIDE[i % 2] * ball.contact_radius_px) for i, ball in enumerate(found)]
    wide = [replace(press, balls=(ball,)) for press, ball in zip(presses(usual.balls), given, strict=True)]
    light = IlluminationMap.of(flat_field)
    whole = fit_to([locate(press, flat_field) for press in wide], light).fit
    calibration = calibrate(wide, usual.rest, PITCH_UM)
    (spread,) = [check for check in calibration.assessment.checks if "radii from shading" in check.name]
    assert spread.passed
    used = [press.balls[0].contact_radius_px for press in calibration.presses]
    assert used == pytest.approx([CORE_FRACTION * ball.contact_radius_px for ball in given])
    assert whole.core_deg is not None
    assert calibration.held_out_deg["direct"] < whole.core_deg
    samples = gather_samples([(press.intensity, press.balls) for press in (locate(one, flat_field) for one in wide)])
    assert radius_spread(radius_shares(samples, whole.map)) > spread.limit


def test_presses_farthest_from_the_others_go_until_the_rest_agrees_and_no_more_than_allowed() -> None:
    presses = np.array([0.84, 0.87, 0.9, 0.93, 0.96, 0.99, 1.0, 1.01, 1.04, 1.07, 1.1, 1.13, 1.2])
    assert radius_spread(presses) > 0.08
    out = left_out(presses, at_most=3.9)
    assert presses[out].tolist() == [0.84, 1.2]
    assert radius_spread(presses[~out]) <= 0.08
    assert not left_out(presses, at_most=1.0).any()
    assert left_out(np.append(presses, 2.0), at_most=1.0).nonzero()[0].tolist() == [13]
    assert not left_out(np.array([0.7, 0.7, 0.7, 1.3, 1.3, 1.3]), at_most=1.8).any()


def test_a_few_of_the_farthest_go_until_chance_explains_the_rest() -> None:
    seven = np.array([0.88, 0.92, 0.96, 1.0, 1.11, 1.15, 1.4])
    out = left_out(seven, at_most=2.1)
    assert seven[out].tolist() == [1.4]
    assert 0.08 < radius_spread(seven[~out]) < 0.12


def test_one_radius_that_fits_is_named_once() -> None:
    words = FittingRadius((200.0,), 5, 7).sentence(100.0, 124.0)
    assert words.startswith("a radius of 200 px (20 mm at 100 µm a pixel) fits the balls that show in 5 of 7 presses")


def test_few_balls_may_differ_by_chance_and_many_may_not() -> None:
    names = [f"press-{k:02d}" for k in range(70)]
    seven = 1.0 + 0.1 * np.array([-1.3, -0.9, -0.6, 0.0, 0.5, 0.9, 1.5])
    assert radius_spread(seven) > 0.09
    check_radii(seven, names)
    check_radii(1.0 + 1.7 * (seven[1:] - 1.0), names)
    for shares in (1.0 + 1.7 * (seven - 1.0), np.tile(1.0 + 1.2 * (seven - 1.0), 10)):
        with pytest.raises(
            CalibrationError, match=r"contradict each other: .*press-00\) to .*press-06\).* press more balls"
        ):
            check_radii(shares, names)


def test_something_that_touches_the_skin_in_the_reference_is_named_with_its_place(usual: SimulatedScene) -> None:
    with pytest.raises(
        CalibrationMismatch, match=r"not of untouched skin: near column \d+, row \d+ .* nothing on the gel"
    ):
        calibrate(presses(usual.balls[1:]), usual.balls[0], PITCH_UM)


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_grey_frames_are_called_one_light(usual: SimulatedScene, noise: float) -> None:
    random = np.random.default_rng(2)

    def grey(frame: LinearFrame) -> LinearFrame:
        rgb = np.repeat(frame.rgb.mean(axis=-1, keepdims=True), 3, axis=-1)
        return replace(frame, rgb=np.abs(rgb + random.normal(0.0, noise, rgb.shape)).astype(np.float32))

    with pytest.raises(CalibrationError, match="all channels show the same light"):
        calibrate(presses([grey(frame) for frame in usual.balls]), grey(usual.rest), PITCH_UM)


def test_presses_of_another_exposure_than_the_reference_are_named(usual: SimulatedScene) -> None:
    darker = [replace(frame, rgb=np.float32(0.5) * frame.rgb) for frame in usual.balls]
    with pytest.raises(CalibrationError, match=r"presses are 0\.[45]\d times as bright as the reference: take the"):
        calibrate(presses(darker), usual.rest, PITCH_UM)


@pytest.mark.parametrize(
    ("view", "words"), [(np.s_[:, ::-1], "mirrored left to right"), (np.s_[::-1, ::-1], "turned by half a turn")]
)
def test_a_press_that_is_turned_against_the_reference_is_named(
    usual: SimulatedScene, view: tuple[slice, ...], words: str
) -> None:
    turned = replace(usual.balls[2], rgb=np.ascontiguousarray(usual.balls[2].rgb[view]))
    with pytest.raises(CalibrationMismatch, match=f"press-02: is {words} against the untouched skin"):
        calibrate(presses([*usual.balls[:2], turned, *usual.balls[3:]]), usual.rest, PITCH_UM)


def test_balls_of_another_radius_than_the_stated_one_are_named(usual: SimulatedScene) -> None:
    stated = [replace(press, radius_px=0.3 * press.radius_px) for press in presses(usual.balls)]
    words = r"a radius from \d+ to \d+ px .* in 6 of 6 presses, and .* is stated: check ball_radius_mm"
    with pytest.raises(CalibrationError, match=words) as refused:
        calibrate(stated, usual.rest, PITCH_UM)
    assert str(refused.value).count("shows no ball") == 1


@pytest.mark.slow
def test_a_diameter_given_as_the_radius_does_not_pass(usual: SimulatedScene) -> None:
    stated = [replace(press, radius_px=2.0 * press.radius_px) for press in presses(usual.balls)]
    assessment = calibrate(stated, usual.rest, PITCH_UM).assessment
    assert any("is ball_radius_mm the diameter?" in check.name for check in assessment.checks if not check.passed)


@pytest.mark.parametrize(("pitch_um", "words"), [(3e7, "too small to be seen"), (3e-3, "no useful contact")])
def test_a_ball_that_no_frame_can_show_is_refused_by_name(usual: SimulatedScene, pitch_um: float, words: str) -> None:
    with pytest.raises(CalibrationError, match=f"press-00: .*{words}"):
        calibrate(presses(usual.balls, pitch_um), usual.rest, pitch_um)


@pytest.mark.slow
def test_a_grid_measures_the_pitch_and_a_gross_contradiction_is_refused(
    usual: SimulatedScene, small_twin: BoardProfile
) -> None:
    frame = shoot_grid(small_twin, SphereGrid(GRID_RADIUS_MM, GRID_PITCH_MM, 2))
    twin = small_twin.twin
    assert twin is not None
    at_tops_um = PITCH_UM * (1.0 - GRID_DEPTH_MM / twin.camera_distance_mm)
    stated_um = 1.02 * PITCH_UM
    calibration = calibrate([grid_press(frame, stated_um)], usual.rest, stated_um)
    sigma_um = calibration.pixel_pitch_sigma_um
    assert sigma_um is not None
    assert 0.0 < sigma_um < 0.004 * PITCH_UM
    assert abs(calibration.pitch_um - at_tops_um) < 2.0 * sigma_um
    assert all(ball.radius_px == pytest.approx(1e3 / calibration.pitch_um) for ball in calibration.presses[0].balls)
    assert any("the stated pixel pitch of 48.96 µm is +2" in note for note in calibration.assessment.notes)
    with pytest.raises(CalibrationError, match=r"grid: its 25 balls 2.5 mm apart .* and 60 µm is stated \(\+2\d%\)"):
        calibrate([grid_press(frame, 60.0)], usual.rest, 60.0)


def test_a_ball_off_the_grid_is_rejected_and_a_missed_one_found(
    usual: SimulatedScene, small_twin: BoardProfile
) -> None:
    image = flat_field_correct(shoot_grid(small_twin, OddGrid()), make_flat_field(usual.rest))
    radius_px = GRID_RADIUS_MM * 1e3 / PITCH_UM
    seen = find_balls(image, radius_px)
    assert len(seen.found) == 25
    grid = detect_grid(image, BallSearch(seen.found[1:], ()), radius_px)
    assert len(grid.search.found) == 24
    assert [ball.reason for ball in grid.search.rejected] == [
        reason for reason in (ball.reason for ball in grid.search.rejected) if reason.startswith("off the grid by 1")
    ]
    assert len(grid.search.rejected) == 1


@pytest.mark.parametrize(("skin", "refused"), [(1.02, False), (1.4, True)])
def test_dark_surroundings_of_the_skin_do_not_refuse_its_reference(skin: float, refused: bool) -> None:
    surroundings = np.broadcast_to((np.arange(96) < 60)[:, None], (96, 128))
    flat_field = np.where(surroundings, 0.004, 0.3).astype(np.float32)[..., None].repeat(3, axis=-1)
    values = np.where(surroundings, 1.4, skin).astype(np.float32)[..., None].repeat(3, axis=-1)
    everywhere = np.ones((96, 128), np.bool_)
    presses = [NormalizedImage(values * np.float32(1.0 + 0.002 * n), everywhere, ~everywhere) for n in range(6)]
    names = [f"press-{number}" for number in range(6)]
    with pytest.raises(CalibrationMismatch, match="is not of these presses") if refused else nullcontext():
        check_agreement(names, presses, flat_field, reference=True)
