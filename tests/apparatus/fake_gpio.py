"""An emulated GPIO line with a real button: bouncing contacts, read as edges like those of libgpiod."""

from __future__ import annotations

import errno
import os
from collections.abc import Sequence
from typing import Final

from hal.drivers.gpio_lines import Edge
from hal.errors import ButtonError
from hal.simulator.bench import SimulatedScene

BOUNCES_MS: Final = (0.0, 0.4, 0.9, 1.3, 3.1, 3.4, 5.2)
"""Times at which a contact changes after it first touches; an odd number, so that it ends in the new state."""

KERNEL_BUFFER: Final = 1024
_UNLIMITED_S: Final = 1e6


class FakeGpioLine:
    """See `hal.drivers.gpio_lines.InputLine`; scheduled presses of the simulated world become bouncing edges.

    Parameters
    ----------
    bounces_ms : see `BOUNCES_MS`
    """

    def __init__(self, bench: SimulatedScene, bounces_ms: Sequence[float] = BOUNCES_MS) -> None:
        self._bench = bench
        self._bounces_ms = bounces_ms
        self._level = False
        self._coming: list[Edge] = []
        self._buffered: list[Edge] = []
        self.held_down = False

    def chatter(self, edges: Sequence[Edge]) -> None:
        """Add further edges."""
        self._coming = sorted([*self._coming, *edges], key=lambda edge: edge.at_ns)

    def wait(self, timeout_s: float | None) -> bool:
        """True when an edge occurred within `timeout_s`."""
        self._check_readable()
        clock = self._bench.clock
        self._pass_until_now()
        if self._buffered:
            return True
        wait_s = _UNLIMITED_S if timeout_s is None else timeout_s
        next_s = (self._coming[0].at_ns - clock.monotonic_ns()) * 1e-9 if self._coming else _UNLIMITED_S
        if timeout_s is None and not self._coming:
            raise ButtonError("no push of the twin's button is scheduled: send its operator a request first")
        clock.sleep(min(wait_s, next_s))
        self._pass_until_now()
        return bool(self._buffered)

    def edges(self) -> list[Edge]:
        """Past edges; the kernel keeps only the newest."""
        buffered, self._buffered = self._buffered[-KERNEL_BUFFER:], []
        return buffered

    def is_active(self) -> bool:
        """The level now."""
        self._check_readable()
        self._pass_until_now()
        return self._level or self.held_down

    def release(self) -> None:
        """Release the line."""
        self._buffered.clear()

    def _pass_until_now(self) -> None:
        """Process every edge that is due."""
        while self._bench.next_button_press() is not None:
            press = self._bench.take_button_press()
            released_ns = press.began_ns + round(press.held_s * 1e9)
            self.chatter([*self._bounced(press.began_ns, True), *self._bounced(released_ns, False)])
        now_ns = self._bench.clock.monotonic_ns()
        while self._coming and self._coming[0].at_ns <= now_ns:
            edge = self._coming.pop(0)
            self._level = edge.active
            self._buffered.append(edge)

    def _bounced(self, at_ns: int, active: bool) -> list[Edge]:
        return [Edge(at_ns + round(ms * 1e6), active == (i % 2 == 0)) for i, ms in enumerate(self._bounces_ms)]

    def _check_readable(self) -> None:
        if self._bench.faults.button_unreadable:
            raise ButtonError(f"the button cannot be read ({os.strerror(errno.ENODEV)}): check its wiring")
