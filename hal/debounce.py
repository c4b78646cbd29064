"""Bouncing edges become presses: a level counts once it has been quiet for a while, and from the first of its edges."""

from __future__ import annotations

from typing import Final

from hal.interfaces import ButtonPress

QUIET_NS: Final = 10_000_000
"""A contact that has not moved for this long has come to rest."""


class Debouncer:
    """Edges in, presses out.

    Parameters
    ----------
    down : the level at the start; a button that is down then counts from its next press
    """

    def __init__(self, down: bool) -> None:
        self._rested = down
        self._level = down
        self._first_ns: int | None = None
        self._last_ns = 0
        self._pressed_ns: int | None = None
        self._presses: list[ButtonPress] = []
        self._told_ns: int | None = None

    def edge(self, at_ns: int, down: bool) -> None:
        """The contact changed its level then; edges come in the order of their times."""
        self.rest(at_ns, self._level)
        if self._first_ns is None:
            self._first_ns = at_ns
        self._last_ns = at_ns
        self._level = down

    def rest(self, now_ns: int, down: bool) -> None:
        """No edge has come until now, where the level is `down`: what was quiet long enough counts.

        A level that no edge has told of is a move like any other and must first come to rest: its edges were lost, or
        are still on their way.
        """
        if down != self._level:
            self._first_ns = now_ns if self._first_ns is None else self._first_ns
            self._last_ns, self._level = now_ns, down
        if self._first_ns is None or now_ns - self._last_ns < QUIET_NS:
            return
        began_ns, self._first_ns = self._first_ns, None
        if down == self._rested:
            return
        self._rested = down
        if down:
            self._pressed_ns = began_ns
        elif self._pressed_ns is not None:
            self._presses.append(ButtonPress(self._pressed_ns, (began_ns - self._pressed_ns) * 1e-9))
            self._pressed_ns = None

    def resting_at_ns(self) -> int | None:
        """When the present unrest would be over; None when all is quiet."""
        return None if self._first_ns is None else self._last_ns + QUIET_NS

    def push(self) -> int | None:
        """When the next press began that was not told yet, ns, over or not; what was told before it is dropped."""
        untold = self._untold()
        if not untold:
            return None
        self._told_ns = untold[0]
        self._presses = [press for press in self._presses if press.began_ns >= untold[0]]
        return untold[0]

    def take(self) -> ButtonPress | None:
        """The next press that is over, if any."""
        return self._presses.pop(0) if self._presses else None

    def forget(self) -> int:
        """Drop every press, one that is still held included; says how many of them were not told."""
        dropped = len(self._untold())
        self._presses.clear()
        self._pressed_ns = None
        return dropped

    def _untold(self) -> list[int]:
        """When the presses began that `push` has not told, ns, oldest first."""
        began = [press.began_ns for press in self._presses]
        if self._pressed_ns is not None:
            began.append(self._pressed_ns)
        return [at_ns for at_ns in began if self._told_ns is None or at_ns > self._told_ns]
