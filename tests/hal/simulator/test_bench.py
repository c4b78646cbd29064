import msgspec
import numpy as np
import pytest

from hal.board_profile import BoardProfile, load_board_profile
from hal.clock import VirtualClock
from hal.errors import BoardProfileError
from hal.frame import CameraSettings
from hal.interfaces import LiftOff, PressBall, PressObject
from hal.simulator.bench import SimulatedScene, build
from hal.simulator.operator import TwinOperator

SHORT = CameraSettings(1_000.0, 1.0)


def signal(bench: SimulatedScene, began_ns: int, settings: CameraSettings = SHORT, index: int = 0) -> np.ndarray:
    frame = bench.expose(index, began_ns, settings)
    return frame.mosaic.astype(np.float64) - frame.black_level_dn


def test_light_follows_current_exposure_and_gain(bench: SimulatedScene) -> None:
    bench.drive({"red": 2.0})
    single = signal(bench, 0).mean()
    assert single > 20.0
    assert signal(bench, 0, CameraSettings(3_000.0, 1.0)).mean() == pytest.approx(3.0 * single, rel=0.01)
    assert signal(bench, 0, CameraSettings(1_000.0, 2.0)).mean() == pytest.approx(2.0 * single, rel=0.01)
    bench.clock.sleep(1.0)
    bench.drive({"red": 4.0})
    assert signal(bench, 1_000_000_000).mean() == pytest.approx(2.0 * single, rel=0.01)


def test_an_exposure_shows_the_light_of_its_own_window(bench: SimulatedScene) -> None:
    bench.clock.sleep(1.0)
    bench.drive({"green": 5.0})
    bench.clock.sleep(1.0)
    bench.drive({})
    whole = signal(bench, 1_000_000_000).mean()
    assert signal(bench, 900_000_000).mean() == pytest.approx(0.0, abs=0.1)
    assert signal(bench, 999_750_000).mean() == pytest.approx(0.75 * whole, rel=0.02)
    assert signal(bench, 1_999_600_000).mean() == pytest.approx(0.4 * whole, rel=0.02)


def test_crosstalk_mixes_the_colours_as_the_profile_says(bench: SimulatedScene) -> None:
    assert bench.twin.crosstalk[1][0] == 0.08
    bench.drive({"red": 10.0})
    seen = signal(bench, 0)
    red, green, blue = seen[0::2, 0::2].mean(), seen[0::2, 1::2].mean(), seen[1::2, 1::2].mean()
    assert green / red == pytest.approx(0.08, rel=0.03)
    assert blue / red == pytest.approx(0.02, rel=0.06)


def test_frames_repeat_with_their_seed_and_index(profile: BoardProfile) -> None:
    first, again, other = (build(profile, VirtualClock(), seed) for seed in (4, 4, 5))
    assert (signal(first, 0) == signal(again, 0)).all()
    assert (signal(first, 0) != signal(other, 0)).any()
    assert (signal(first, 0) != signal(first, 0, index=1)).any()


def test_truth_is_the_ball_on_the_pixel_grid(bench: SimulatedScene) -> None:
    TwinOperator(bench).ask(PressBall(3.0, 0.5, 0.5))
    press, truth = bench.pressed, bench.truth()
    assert press is not None
    assert truth.z_um.shape == truth.p.shape == truth.q.shape == truth.contact.shape == (272, 364)
    assert truth.pitch_um == 48.0
    row, column = np.unravel_index(int(truth.z_um.argmax()), truth.z_um.shape)
    assert column == pytest.approx(press.centre_mm[0] / 0.048 + 181.5, abs=1.0)
    assert row == pytest.approx(press.centre_mm[1] / 0.048 + 135.5, abs=1.0)
    assert truth.p[row, column - 20] > 0.2
    assert truth.q[row - 20, column] > 0.2
    rim_deg = np.degrees(np.arctan(np.hypot(truth.p, truth.q)[truth.contact].max()))
    assert rim_deg == pytest.approx(40.0, abs=1.5)


@pytest.mark.parametrize("shares", [(0.0, 0.0), (1.0, 0.0), (0.5, 1.0), (0.2, 0.8)])
def test_a_ball_is_pressed_inside_the_field_and_only_roughly_there(
    bench: SimulatedScene, shares: tuple[float, float]
) -> None:
    operator, places = TwinOperator(bench), []
    for _ in range(2):
        operator.ask(PressBall(3.0, *shares))
        contact = bench.truth().contact
        assert contact.any()
        assert contact.sum() == contact[1:-1, 1:-1].sum()
        press = bench.pressed
        assert press is not None
        places.append(press.centre_mm)
    if shares == (0.2, 0.8):
        assert places[0] != places[1]
        np.testing.assert_allclose(places, [[-5.2416, 3.9168]] * 2, atol=0.6)


def test_a_large_ball_is_pressed_less_steeply(bench: SimulatedScene) -> None:
    TwinOperator(bench).ask(PressBall(12.0, 0.5, 0.5))
    truth = bench.truth()
    assert truth.z_um.max() <= 0.6 * 2500.0
    assert 5.0 < np.degrees(np.arctan(np.hypot(truth.p, truth.q)[truth.contact].max())) < 39.0


def test_lifting_off_leaves_the_skin_at_rest(bench: SimulatedScene) -> None:
    operator = TwinOperator(bench)
    operator.ask(PressObject("coin"))
    assert bench.truth().contact.any()
    bench.clock.sleep(1.0)
    operator.ask(LiftOff())
    assert not bench.truth().z_um.any()


def test_a_press_changes_frames_from_then_on(bench: SimulatedScene) -> None:
    bench.drive(bench.profile.currents_ma)
    bench.clock.sleep(1.0)
    TwinOperator(bench).ask(PressObject("coin"))
    before, after = signal(bench, 500_000_000), signal(bench, 1_500_000_000)
    rest = signal(bench, 100_000_000)
    assert np.abs(before - rest).max() == 0.0
    assert np.abs(after - rest).max() > 200.0


@pytest.mark.parametrize(("columns", "rows"), [(640, 480), (642, 486)])
def test_other_sizes_work(profile: BoardProfile, columns: int, rows: int) -> None:
    sensor = msgspec.structs.replace(profile.sensor, columns=columns, rows=rows, pixel_pitch_um=25.0)
    bench = build(msgspec.structs.replace(profile, sensor=sensor), VirtualClock())
    TwinOperator(bench).ask(PressBall(3.0, 0.4, 0.6))
    assert bench.expose(0, 0, SHORT).shape == (rows, columns) == bench.truth().z_um.shape


@pytest.mark.parametrize("name", ["twin", "twin-distant"])
def test_reference_exposure_leaves_room_above_a_ball(name: str) -> None:
    profile = load_board_profile(name)
    bench = build(profile, VirtualClock())
    bench.drive(profile.currents_ma)
    TwinOperator(bench).ask(PressBall(3.0, 0.15, 0.8))
    frame = bench.expose(0, 0, profile.camera.settings)
    share = (frame.mosaic - frame.black_level_dn) / (frame.white_level_dn - frame.black_level_dn)
    assert 0.75 < np.percentile(share, 99.9) <= 0.9
    assert 0.25 < np.median(share) < 0.6


def test_a_board_without_a_twin_table_is_refused(profile: BoardProfile) -> None:
    with pytest.raises(BoardProfileError, match=r"\[twin\]"):
        build(msgspec.structs.replace(profile, twin=None), VirtualClock())
