"""The fault menu of the demonstration, by key presses; on an instrument it does not exist."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from device.cli.guide import prepare_demo
from device.store.store import BundleStore
from hal.clock import VirtualClock
from tests.device.tui.conftest import Stage


def test_key_f_switches_a_fault_on_and_off_again(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await stage.press("f")
        assert "[ ] dim: the blue light is 10 % weaker" in stage.text()
        await stage.press("enter")
        await stage.live(2)
        assert stage.bench.faults.dimmed == {"blue": 0.9}
        await stage.press("f")
        assert "[x] dim" in stage.text()
        await stage.press("enter")
        await stage.live(2)
        assert stage.bench.faults.dimmed == {}
        await stage.press("f", *["down"] * 7, "enter")
        await stage.live(350)
        assert "No room for another scan" in stage.text()

    play(scenario, root, is_demo=True)


def test_a_stalled_camera_is_said_on_every_screen_until_it_delivers_again(
    play: Callable[..., None], root: Path
) -> None:
    async def scenario(stage: Stage) -> None:
        await stage.object_pressed()
        await stage.live(20)
        assert "Ready" in stage.text()
        await stage.press("f", "end")
        assert "[ ] stall: the camera delivers no more frames" in stage.text()
        await stage.press("enter")
        await stage.live()
        for place in ("1", "2", "3", "4", "1"):
            await stage.press(place)
            for _ in range(3):
                await stage.live()
                assert "Ready" not in stage.text()
                assert "delivers no frame" in stage.text(), place
        await stage.press("f", "end", "enter")
        await stage.live(30)
        assert "delivers no frame" not in stage.text()
        assert "Ready" in stage.text()

    play(scenario, root, is_demo=True)


def test_sentences_of_a_broken_light_wrap_instead_of_being_cut(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await stage.live(24)
        await stage.press("f", "down", "enter")
        await stage.live(2)
        await stage.object_pressed()
        await stage.live(3)
        cells, left = stage.lines(), stage.app.screen.query_one("#verdict").region.x
        beside = " ".join(" ".join(line[left:] for line in cells).split())
        assert "RETAKE #1 light blue is at" in beside
        assert "run the self-test (key 4)" in beside
        below = " ".join(" ".join(cells[-7:]).split())
        assert "wires, and run the self-test (key 4)" in below

    play(scenario, root, is_demo=True)


def test_an_instrument_has_no_fault_menu(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        before = stage.text()
        await stage.press("f")
        assert "Faults of the twin" not in stage.text()
        assert "faults" not in before

    play(scenario, root)


def test_the_first_start_calibrates_and_the_second_does_not(small_board: Path, tmp_path: Path) -> None:
    prepare_demo(tmp_path / "demo", str(small_board))
    prepare_demo(tmp_path / "demo", str(small_board))
    store = BundleStore(tmp_path / "demo", VirtualClock(start_ns=5_000))
    assert len(store.calibrations().bundles) == 1
    assert store.active_calibration().calibration_id == store.calibrations().bundles[0].calibration_id


async def demonstrated(stage: Stage) -> None:
    """Key d presses an object, Space scans or touches, and the hand lifts."""
    await stage.press("d")
    await stage.live(3)
    await stage.press("space")
    await stage.live(2)
    assert "ignored" not in stage.text()
    stage.bench.place(None)
    stage.bench.clock.sleep(1.0)
    await stage.live(30)


def test_the_way_back_to_a_demonstrated_scan_is_found(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await stage.live(24)
        await demonstrated(stage)
        assert stage.instrument.state.scans_stored == 1
        await stage.press("3", "w")
        await stage.live(2)
        await demonstrated(stage)
        assert not stage.instrument.state.spot.is_reached
        for _ in range(4):
            await demonstrated(stage)
            if stage.instrument.state.spot.is_reached:
                break
        assert stage.instrument.state.spot.is_reached
        assert stage.instrument.state.scans_stored == 1

    play(scenario, root, is_demo=True)


def test_a_second_press_before_the_touch_does_not_lead_astray(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await stage.live(24)
        await demonstrated(stage)
        await stage.press("3", "w")
        await stage.live(2)
        places = []
        for _ in range(4):
            await stage.press("d")
            await stage.live(1)
            places.append(complex(*stage.bench.pressed.centre_mm))
        assert max(abs(place - places[0]) for place in places) < 0.5
        await stage.press("space")
        await stage.live(2)
        stage.bench.place(None)
        stage.bench.clock.sleep(1.0)
        await stage.live(30)
        assert stage.instrument.state.spot.way is not None

    play(scenario, root, is_demo=True)


def test_a_touch_that_is_not_recognised_leads_back(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await stage.live(24)
        await demonstrated(stage)
        await stage.press("3", "w")
        await stage.live(2)
        places = []
        for _ in range(6):
            await stage.press("d")
            await stage.live(1)
            places.append(complex(*stage.bench.pressed.centre_mm))
            states = stage.instrument._states
            states.update(spot=replace(states.state.spot, sentence="Place unknown"))
        assert max(abs(place - places[0]) for place in places) < 3.0

    play(scenario, root, is_demo=True)


def test_an_area_is_covered_in_the_demonstration(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await stage.live(24)
        await stage.press("w", *"22", "enter", *"16", "enter")
        await stage.live(2)
        area = stage.instrument.state.area
        assert (area.width_mm, area.height_mm) == (22.0, 16.0)  # what is typed replaces the present values
        for _ in range(10):
            await demonstrated(stage)
            if stage.instrument.state.area.is_done:
                break
        assert stage.instrument.state.area.is_done

    play(scenario, root, is_demo=True)


def test_ctrl_c_ends_with_its_own_exit_code(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await stage.pilot.press("ctrl+c")
        await stage.pilot.pause()
        assert stage.app.return_code == 130

    play(scenario, root)
