"""The line that lets a light driver's outputs through: with nobody at the line a pull keeps the skin dark and cool."""

from __future__ import annotations

from typing import Protocol


class SwitchedLine(Protocol):
    """An output line."""

    def switch(self, on: bool) -> None:
        """Drive the line; the first call requests it."""
        ...

    def release(self) -> None:
        """Release the line."""
        ...


class LightGate:
    """Output enable of a PCA9955B, open only while something shines; or reset of a TLC59116, which then forgets all.

    Parameters
    ----------
    line : None where the pin is tied, and the outputs follow the registers alone
    holds_reset : the line keeps the chip in reset, so it stays open from `wake` to `close`
    """

    def __init__(self, line: SwitchedLine | None = None, *, holds_reset: bool = False) -> None:
        self._line = line
        self._holds_reset = holds_reset

    def wake(self) -> None:
        """Before the chip is first written: out of reset, or dark."""
        if self._line is not None:
            self._line.switch(self._holds_reset)

    def shine(self, lit: bool) -> None:
        """Let the outputs through, or not."""
        if self._line is not None and not self._holds_reset:
            self._line.switch(lit)

    def close(self) -> None:
        """Dark, and the line released to its pull."""
        if self._line is not None:
            try:
                self._line.switch(False)
            finally:
                self._line.release()
