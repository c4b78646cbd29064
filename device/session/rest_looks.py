"""When the instrument looks at untouched skin: between presses, as soon as the hand is gone, and then now and again."""

from __future__ import annotations

from concurrent.futures import Executor, Future
from typing import Final

from device.health_limits import MOVING
from device.scanning.scan_health import ScanHealth
from device.session.live_loop import LiveFrame

CALM_FRAMES: Final = 5
SOON_S: Final = 0.3
NOW_AND_AGAIN_S: Final = 10.0


class RestLooks:
    """Looks of one scanner's health at live frames."""

    def __init__(self, health: ScanHealth, executor: Executor) -> None:
        self._health = health
        self._executor = executor
        self._look: Future[bool] | None = None
        self._calm = 0
        self._wanted = True
        self._looked_ns = 0

    def want(self) -> None:
        """A press was taken: the next chance counts."""
        self._wanted = True

    def step(self, live: LiveFrame) -> bool:
        """Look at a live frame when it is time, and say whether the state of the lights is news."""
        news = False
        if self._look and self._look.done():
            news = self._look.result()
            self._wanted = self._wanted and not news
            self._look = None
        motion = live.reading.motion
        self._calm = self._calm + 1 if motion is not None and motion < MOVING else 0
        at_ns = live.frame.sensor_timestamp_ns
        wait_s = SOON_S if self._wanted else NOW_AND_AGAIN_S
        if self._look is None and self._calm >= CALM_FRAMES and at_ns - self._looked_ns >= wait_s * 1e9:
            self._looked_ns = at_ns
            self._look = self._executor.submit(self._health.look, live.frame)
        return news
