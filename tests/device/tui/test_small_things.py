"""Small promises of the screens, each by key presses."""

from collections.abc import AsyncIterator, Callable
from datetime import UTC, datetime
from pathlib import Path

import pytest
from textual.widgets import Input

from device.instrument.state import CalibrationState, GelState, HealthState, InstrumentState
from device.tui.drawing.text import local_time
from device.tui.screens.app import FRAMEWORK_ACTIONS
from device.tui.screens.panels import battery_text
from device.tui.widgets.dialogs import KeysDialog
from device.tui.widgets.navigation import KeyHint, Notice, Severity
from hal.interfaces import PowerReading
from tests.device.tui.conftest import Stage


def test_a_gels_name_has_its_rule_beside_it_and_what_was_typed_stays(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await stage.press("4", *["down"] * 8, "enter", "end", "enter")
        assert "Lower-case letters, digits and hyphens" in stage.text()
        await stage.press(*"Gel", "enter", "enter")
        assert "! gel 'Gel': use lower-case letters" in stage.text()
        assert stage.app.screen.query(Input).first().value == "Gel"
        await stage.press("tab")
        stage.app.screen.query(Input).first().value = "gel-9"
        stage.app.screen.query(Input).last().focus()
        await stage.press("end", "x", "enter")
        assert "is not a thickness in mm" in stage.text()
        await stage.press("backspace", "enter")
        await stage.live(2)
        assert stage.instrument.state.gel.gel_id == "gel-9"

    play(scenario, root, size=(100, 30))


def test_a_note_is_kept_when_more_is_typed(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await stage.object_pressed()
        await stage.press("3", "n", *"one", "enter")
        await stage.press("n", *"two", "enter")
        assert "onetwo" in stage.text()

    play(scenario, root)


def test_every_key_is_listed_under_the_question_mark(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await stage.press("3", "question_mark")
        shown = stage.text()
        for words in ("Set-up", "unmark", "profile", "last line", "quit", "note"):
            assert words in shown
        await stage.press("escape")
        assert "Keys of this screen" not in stage.text()

    play(scenario, root, size=(80, 40))


@pytest.mark.parametrize("size", [(80, 24), (40, 16)])
def test_the_keys_of_a_small_screen_are_scrolled_and_are_its_own(
    play: Callable[..., None], root: Path, size: tuple[int, int]
) -> None:
    async def scenario(stage: Stage) -> None:
        await stage.press("question_mark")
        shown = stage.text()
        assert "Escape: close" in shown
        await stage.press("end")
        shown += stage.text()
        for words in ("number parts", "quit"):
            assert words in shown
        for words in ("Focus Next", "Copy selected"):
            assert words not in shown

    play(scenario, root, size=size)


async def _every_screen(stage: Stage) -> AsyncIterator[str]:
    """Every screen with all the keys that it can have, one after the other."""
    await stage.object_pressed()
    yield "scan"
    await stage.press("p")
    yield "profile"
    await stage.press("p", "3")
    yield "scans"
    await stage.press("p")
    yield "scans, profile"
    await stage.press("p", "4")
    yield "set-up"
    await stage.press("2")
    yield "calibrate"
    await stage.press("space")
    await stage.live(2)
    yield "calibrating"


@pytest.mark.parametrize("is_demo", [False, True])
@pytest.mark.parametrize("size", [(80, 24), (40, 16)])
def test_no_hint_is_cut_and_every_key_is_shown_or_listed(
    play: Callable[..., None], root: Path, size: tuple[int, int], is_demo: bool
) -> None:
    async def scenario(stage: Stage) -> None:
        async for name in _every_screen(stage):
            screen = stage.app.screen
            hints = screen.query(KeyHint)
            line = stage.lines()[-1]
            assert line == "".join(str(hint.content) for hint in hints).rstrip(), name
            assert len(line) <= size[0], name
            for wanted in ("? keys", "q quit", *(["f faults"] if is_demo else [])):
                assert wanted in line, name
            keys = {
                stage.app.get_key_display(active.binding)
                for active in screen.active_bindings.values()
                if active.enabled and active.binding.action not in FRAMEWORK_ACTIONS
            }
            await stage.pilot.press("question_mark")
            dialog = stage.app.screen
            assert isinstance(dialog, KeysDialog), name
            assert keys == {key for key, _ in dialog.keys}, name
            await stage.pilot.press("escape")

    play(scenario, root, size=size, is_demo=is_demo)


def test_a_line_with_room_has_every_hint(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await stage.object_pressed()
        narrow = stage.lines()[-1]
        await stage.pilot.resize_terminal(100, 24)
        await stage.show()
        wide = stage.lines()[-1]
        assert "z zero" not in narrow
        for words in ("p profile", "space scan", "z zero", "d press", "f faults", "q quit"):
            assert words in wide

    play(scenario, root, is_demo=True)


def test_way_back_and_area_are_in_the_bottom_line_and_in_words_under_the_question_mark(
    play: Callable[..., None], root: Path
) -> None:
    async def scenario(stage: Stage) -> None:
        await stage.object_pressed()
        assert " w area " in stage.lines()[-1]
        await stage.press("question_mark", "end")
        assert "cover an area larger than the field" in stage.text()
        await stage.press("escape", "3")
        assert " w spot " in stage.lines()[-1]
        await stage.press("question_mark", "end")
        assert "way back to this scan's spot" in stage.text()

    play(scenario, root)


def test_a_small_terminal_is_named(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        assert "too small, needs 40x16" in stage.text()
        await stage.pilot.resize_terminal(80, 24)
        await stage.show()
        assert "too small" not in stage.text()

    play(scenario, root, size=(39, 15))


def test_times_are_local() -> None:
    at = datetime(2026, 7, 1, 12, 0, tzinfo=UTC)
    assert local_time(at) == f"{datetime.fromtimestamp(at.timestamp()):%Y-%m-%d %H:%M}"


def test_a_gauge_that_the_profile_names_does_not_answer_rather_than_not_exist() -> None:
    state = InstrumentState(
        activity="ready",
        board="pi5-imx296",
        device_id="rg12345678",
        calibration=CalibrationState(),
        gel=GelState("gel", 2.5, 3),
        health=HealthState({}),
        power=PowerReading(),
    )
    assert "does not answer" in battery_text(state, has_gauge=True)
    assert battery_text(state, has_gauge=False) == "no battery gauge"


def test_what_is_uncovered_is_said_while_one_can_still_press(play: Callable[..., None], empty_root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await stage.press("2", "space")
        await stage.live(2)
        seen = []
        for _ in range(11):
            await stage.press("space")
            await stage.live(3)
            if stage.instrument.state.activity == "calibrating":
                seen.append("uncovered" in stage.text())
        assert not any(seen[:6])
        assert any(seen)

    play(scenario, empty_root, size=(100, 30))


def test_a_notice_goes_after_a_while_and_with_its_screen(
    play: Callable[..., None], root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def story(stage: Stage) -> None:
        time_s = 0.0
        monkeypatch.setattr(stage.app, "now_ns", lambda: int(time_s * 1e9))

        async def shown_after(seconds: float) -> Notice | None:
            nonlocal time_s
            await stage.show()
            time_s += seconds
            await stage.show()
            return stage.app.notice

        severities: tuple[Severity, ...] = ("info", "success")
        for severity in severities:
            stage.app.notice = Notice("Said.", severity)
            assert await shown_after(19.0)
            assert await shown_after(2.0) is None
        stage.app.notice = Notice("Joining a network ...")
        assert await shown_after(900.0)
        await stage.press("3")
        assert stage.app.notice == Notice("Joining a network ...")
        stage.app.report_failure("not joined")
        await stage.press("3")
        assert stage.app.notice is not None
        await stage.press("1")
        assert await shown_after(900.0) == Notice("not joined", "error")
        stage.app.notice = Notice("Said.")
        await stage.press("3")
        assert stage.app.notice is None

    play(story, root)
