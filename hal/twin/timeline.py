"""What held when: values that change at points of time."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final, Generic, TypeVar

Value = TypeVar("Value")

_KEPT_NS: Final = 60_000_000_000
"""Age at which a value that no longer holds is forgotten: longer than any exposure."""


class Timeline(Generic[Value]):
    """A value and its recent past.

    Parameters
    ----------
    start_ns : time from which, and before which, the first value holds
    value : the first value
    """

    def __init__(self, start_ns: int, value: Value) -> None:
        self._changes: list[tuple[int, Value]] = [(start_ns, value)]

    def change(self, at_ns: int, value: Value) -> None:
        """From `at_ns` on, `value` holds; changes come in the order of their times."""
        self._changes.append((at_ns, value))
        while len(self._changes) > 1 and self._changes[1][0] < at_ns - _KEPT_NS:
            del self._changes[0]

    @property
    def latest(self) -> Value:
        """The value that holds now."""
        return self._changes[-1][1]

    def value_at(self, at_ns: int) -> Value:
        """The value that held at that time."""
        held = self._changes[0][1]
        for start_ns, value in self._changes:
            if start_ns > at_ns:
                break
            held = value
        return held

    def spans(self, began_ns: int, ended_ns: int) -> Iterator[tuple[int, Value]]:
        """Every value that held within the interval, with the time (ns) for which it did."""
        ends = [start for start, _ in self._changes[1:]] + [ended_ns]
        starts = [began_ns] + [start for start, _ in self._changes[1:]]
        for (_, value), start, end in zip(self._changes, starts, ends, strict=True):
            overlap_ns = min(end, ended_ns) - max(start, began_ns)
            if overlap_ns > 0:
                yield overlap_ns, value
