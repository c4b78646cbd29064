"""The indicator as one-bit rhythms, for an LED or a buzzer."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, Self

from hal.interfaces import Clock, Cue

_SHORT: Final = (0.06, 0.06)
_LONG: Final = (0.5, 0.1)

RHYTHMS: Final[dict[Cue, tuple[tuple[float, float], ...]]] = {
    "idle": (),
    "busy": (),
    "may lift": (_SHORT,),
    "good": (_SHORT, _SHORT),
    "doubtful": (_SHORT, _SHORT, _SHORT),
    "retake": (_LONG,),
    "refused": (_LONG, _SHORT, _SHORT),
    "refused: calibration": (_LONG, _SHORT, _SHORT, _SHORT),
    "refused: full": (_SHORT, _LONG),
    "refused: hardware": (_SHORT, _SHORT, _LONG),
    "pairing": (_SHORT, _LONG, _SHORT),
    "calibration": (_LONG, _SHORT),
}
"""On and off times, in seconds, of each cue."""


class BlinkIndicator:
    """See `hal.interfaces.Indicator`.

    Parameters
    ----------
    switch : turns it on or off
    release : releases it
    """

    def __init__(self, switch: Callable[[bool], None], release: Callable[[], None], clock: Clock) -> None:
        self._switch = switch
        self._release = release
        self._clock = clock

    def show(self, cue: Cue) -> None:
        """Play a cue; it stays on while busy, else goes off."""
        for on_s, off_s in RHYTHMS[cue]:
            self._switch(True)
            self._clock.sleep(on_s)
            self._switch(False)
            self._clock.sleep(off_s)
        self._switch(cue == "busy")

    def __enter__(self) -> Self:
        self._switch(False)
        return self

    def __exit__(self, *exc: object) -> None:
        try:
            self._switch(False)
        finally:
            self._release()


class NoIndicator:
    """The indicator of a board that has none: cues appear on the screen only."""

    def show(self, cue: Cue) -> None:
        """No-op."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        return None
