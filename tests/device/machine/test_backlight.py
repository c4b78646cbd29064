"""Brightness through a folder in the place of the kernel's."""

import os
from pathlib import Path

import pytest

from device.errors import MachineError
from device.machine.machines import MIN_LEVEL, SysfsBacklight


@pytest.fixture
def panel(tmp_path: Path) -> Path:
    folder = tmp_path / "backlight" / "10-0045"
    folder.mkdir(parents=True)
    (folder / "max_brightness").write_text("255\n")
    (folder / "brightness").write_text("128\n")
    return folder


def test_the_level_is_read_and_set(panel: Path) -> None:
    backlight = SysfsBacklight(panel.parent)
    assert backlight.level() == 128 / 255
    backlight.set_level(0.25)
    assert (panel / "brightness").read_text() == "64\n"
    backlight.set_level(2.0)
    assert backlight.level() == 1.0


def test_it_never_goes_dark(panel: Path) -> None:
    backlight = SysfsBacklight(panel.parent)
    backlight.set_level(0.0)
    assert backlight.level() == pytest.approx(MIN_LEVEL, abs=1 / 255)
    (panel / "max_brightness").write_text("7\n")
    backlight.set_level(0.0)
    assert (panel / "brightness").read_text() == "1\n"


def test_a_machine_without_a_panel(tmp_path: Path) -> None:
    for folder in (tmp_path / "absent", tmp_path):
        backlight = SysfsBacklight(folder)
        assert backlight.level() is None
        with pytest.raises(MachineError, match="no panel whose brightness can be set"):
            backlight.set_level(1.0)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write any file")
def test_a_file_that_may_not_be_written(panel: Path) -> None:
    (panel / "brightness").chmod(0o444)
    with pytest.raises(MachineError, match="this user may not write it"):
        SysfsBacklight(panel.parent).set_level(1.0)


def test_damaged_figures_are_named(panel: Path) -> None:
    (panel / "max_brightness").write_text("0\n")
    with pytest.raises(MachineError, match="max_brightness: 0 is no brightness"):
        SysfsBacklight(panel.parent).level()
    (panel / "max_brightness").write_text("bright\n")
    with pytest.raises(MachineError, match="max_brightness: cannot be read as a number"):
        SysfsBacklight(panel.parent).level()
