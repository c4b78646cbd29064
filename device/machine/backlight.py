"""Brightness of the panel through the kernel's backlight files; a udev rule lets the instrument's user write them."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from device.errors import MachineError

BACKLIGHTS: Final = Path("/sys/class/backlight")

MIN_LEVEL: Final = 0.05
"""Darkest level that is set: at 0 many panels are black, and nobody could find the way back."""


class SysfsBacklight:
    """The first backlight of this machine.

    Parameters
    ----------
    folder : of the kernel's backlights
    """

    def __init__(self, folder: Path = BACKLIGHTS) -> None:
        self._folder = folder

    def level(self) -> float | None:
        """Present brightness; None without a backlight. Errors as for `Backlight.level`."""
        panel = self._panel()
        return None if panel is None else _number(panel / "brightness") / self._brightest(panel)

    def set_level(self, level: float) -> None:
        """Set the brightness, from `MIN_LEVEL` to 1.

        Raises
        ------
        MachineError
            There is no backlight, or it cannot be written.
        """
        panel = self._panel()
        if panel is None:
            raise MachineError("this machine has no panel whose brightness can be set")
        steps = max(round(min(max(level, MIN_LEVEL), 1.0) * self._brightest(panel)), 1)
        try:
            (panel / "brightness").write_text(f"{steps}\n", encoding="ascii")
        except PermissionError as error:
            raise MachineError(
                f"{panel / 'brightness'}: this user may not write it: run board/install.sh again for its rule"
            ) from error
        except OSError as error:
            raise MachineError(f"{panel / 'brightness'}: cannot be written ({error.strerror})") from error

    def _panel(self) -> Path | None:
        try:
            panels = sorted(self._folder.iterdir())
        except OSError:
            return None
        return panels[0] if panels else None

    @staticmethod
    def _brightest(panel: Path) -> int:
        brightest = _number(panel / "max_brightness")
        if brightest < 1:
            raise MachineError(f"{panel / 'max_brightness'}: {brightest} is no brightness")
        return brightest


def _number(path: Path) -> int:
    try:
        return int(path.read_text(encoding="ascii"))
    except (OSError, ValueError) as error:
        raise MachineError(f"{path}: cannot be read as a number") from error
