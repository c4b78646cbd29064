"""Each step of the bench checklist says what to expect and what to do if not; what it names exists, its script runs."""

import re
from pathlib import Path

import pytest

from tests.drawings.board.wiring import wired_boards, wiring

PAGE = (Path(__file__).parents[2] / "board" / "bench-checklist.md").read_text(encoding="utf-8")
STEPS = re.findall(r"^- \[ \] (.*?)(?=^- \[ \]|^## |\Z)", PAGE, re.MULTILINE | re.DOTALL)


def test_every_step_says_what_to_expect_and_what_to_do_if_not() -> None:
    assert len(STEPS) > 50
    assert [step for step in STEPS if step.count("*Expect*") != 1 or step.count("*Else*") != 1] == []


def test_sections_are_numbered_in_the_order_of_the_day() -> None:
    assert [int(number) for number in re.findall(r"^## (\d+)\. ", PAGE, re.MULTILINE)] == list(range(1, 10))


def test_its_script_lights_a_light_and_prints_what_was_granted(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (script,) = re.findall(r"^```python\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
    asked: list[str] = []
    monkeypatch.setattr("builtins.input", asked.append)
    printed = []
    for run in (script, script.replace('switch_on({"red": 10.0})', "off()")):
        exec(compile(run.replace("pi5-imx296", "twin"), "bench-checklist.md", "exec", dont_inherit=True), {})  # noqa: S102
        printed.append(capsys.readouterr().out)
    assert asked == ["lit until Enter"] * 2
    granted_us = [float(us) for text in printed for us in re.findall(r"exposure_us=([\d.]+)", text)]
    assert granted_us == pytest.approx([3000.0] * 2, rel=0.02)
    lit, dark = (float(text.split()[-1]) for text in printed)
    assert lit > 100.0 > 5.0 > abs(dark)


def test_the_pins_that_it_looks_at_are_those_that_are_wired() -> None:
    lines = {
        int(wire.pin_name.removeprefix("GPIO"))
        for b in wired_boards()
        for wire in wiring(b).wires
        if "line" in wire.kind
    }
    asked = re.search(r"pinctrl get ([\d,]+)", PAGE)
    assert asked
    assert {int(line) for line in asked[1].split(",")} == lines - {27}  # the indicator is an output
