"""The thin layer on libgpiod: its own event and value types, with a scripted request."""

import errno
import os
import sys
from pathlib import Path
from typing import Any

import pytest

gpiod = pytest.importorskip("gpiod", reason="libgpiod is not installed: pip install 'retrograph[device]'")

from hal.drivers.gpio_lines import Edge, GpiodInput, GpiodOutput  # noqa: E402
from hal.errors import ButtonError, DriverMissing, IndicatorError  # noqa: E402


class ScriptedRequest:
    """Behaves like libgpiod's LineRequest, for one line."""

    offsets = (17,)

    def __init__(self) -> None:
        self.error: OSError | None = None
        self.released = False

    def _may_fail(self) -> None:
        if self.error:
            raise self.error

    def wait_edge_events(self, _timeout: float | None) -> bool:
        self._may_fail()
        return True

    def read_edge_events(self) -> list[Any]:
        self._may_fail()
        kinds = (gpiod._ext.EDGE_EVENT_TYPE_RISING, gpiod._ext.EDGE_EVENT_TYPE_FALLING)
        return [gpiod.EdgeEvent(kind, 100 + n, 17, n, n) for n, kind in enumerate(kinds)]

    def get_value(self, line: int) -> Any:
        self._may_fail()
        assert line in self.offsets
        return gpiod.line.Value.ACTIVE

    def release(self) -> None:
        self.released = True


def test_rising_is_active_and_times_are_kept() -> None:
    request = ScriptedRequest()
    line = GpiodInput(request, "the button")
    assert line.wait(1.0)
    assert line.edges() == [Edge(100, True), Edge(101, False)]
    assert line.is_active()
    line.release()
    assert request.released


def test_a_line_that_fails_is_named() -> None:
    request = ScriptedRequest()
    request.error = OSError(errno.ENODEV, os.strerror(errno.ENODEV))
    line = GpiodInput(request, "the button on line 17")
    for read in (lambda: line.wait(0.0), line.edges, line.is_active):
        with pytest.raises(ButtonError, match=r"the button on line 17 cannot be read \(No such device\)"):
            read()


@pytest.mark.parametrize(
    ("source", "reported"),
    [
        (
            "def version_string():\n    return '1.6.3'\n",
            r"version 1\.6\.3, but version 2 is needed: pip install 'gpiod>=2",
        ),
        ("class chip: ...\n", r"version 1, but version 2 is needed"),
        ("raise ImportError('libgpiod.so.2: no such file')", r"cannot be imported \(libgpiod\.so\.2"),
    ],
)
def test_a_library_of_version_1_or_a_broken_one_is_named(
    source: str, reported: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "gpiod.py").write_text(source, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    for name in [name for name in sys.modules if name.split(".")[0] == "gpiod"]:
        monkeypatch.delitem(sys.modules, name)
    with pytest.raises(DriverMissing, match=reported):
        GpiodInput.open("pinctrl-rp1", 17, active_low=True)
    with pytest.raises(DriverMissing, match=reported):
        GpiodOutput("pinctrl-rp1", 27).switch(True)


def test_a_chip_that_is_not_there_lists_those_that_are(tmp_path: Path) -> None:
    (tmp_path / "gpiochip0").write_text("no device")
    with pytest.raises(ButtonError, match=r"'pinctrl-rp1' not found: .*gpiochip0 \(cannot be opened\).*chip_label"):
        GpiodInput.open("pinctrl-rp1", 17, active_low=True, devices=tmp_path)
    output = GpiodOutput("pinctrl-rp1", 27, tmp_path)
    with pytest.raises(IndicatorError, match="the indicator on line 27"):
        output.switch(True)
    output.release()
