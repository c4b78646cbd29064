"""The live stream: lights on, one frame after the other to the coach; dark and asleep when nobody does anything."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from device.coaching.coach import Coach, CoachModel
from device.coaching.coach_reading import CoachReading
from device.coaching.thin_frame import thin, thinning
from device.health_limits import STILL_S
from device.scanning.capture import FRAME_TIMEOUT_S, CapturePlan, after_restarts, check_frame
from device.session.noticeboard import Noticeboard
from device.session.state import LiveView
from hal.frame import RawFrame
from hal.hardware import Hardware

ASLEEP_AFTER_S: Final = 120.0
"""Without contact, press or command for so long the lights go dark: they warm the gel and eat the battery."""

PERIOD_S: Final = 0.05
"""Twenty looks a second are plenty for a hand; between them the button is listened to."""

LATEST_MOTION_S: Final = 0.5
"""A live frame that is older says nothing of how the contact moved."""


@dataclass(frozen=True, slots=True, eq=False)
class LiveFrame:
    """A frame of the live stream, whole, and its reading."""

    frame: RawFrame
    reading: CoachReading


class LiveLoop:
    """The live stream of one instrument; only the thread that owns the hardware calls it."""

    def __init__(self, hardware: Hardware, board: Noticeboard) -> None:
        self._hardware = hardware
        self._board = board
        self._plan: CapturePlan | None = None
        self._coach = Coach(None)
        self._lit = False
        self._awake_ns = hardware.clock.monotonic_ns()
        self._fired = False
        self._stepped_ns = 0
        self._at_ns: int | None = None

    def begin(self, plan: CapturePlan, model: CoachModel | None) -> None:
        """Stream with these settings from now on, and coach by this model."""
        self._hardware.camera.apply(plan.settings)
        self._plan = plan
        self._coach = Coach(model)
        self._lit = False
        self.wake()

    def expect(self, levels: tuple[float, float, float]) -> None:
        """Take these levels of the lights, over the reference's, for those of untouched skin."""
        self._coach.expect(levels)

    def motion(self, frame: RawFrame) -> float | None:
        """How much a frame differs from the last live one; None when that is long ago."""
        at_ns = self._at_ns
        if at_ns is None or frame.sensor_timestamp_ns - at_ns > LATEST_MOTION_S * 1e9:
            return None
        return self._coach.motion(thin(frame))

    def wake(self) -> None:
        """Somebody did something."""
        self._awake_ns = self._hardware.clock.monotonic_ns()

    def darkened(self) -> None:
        """Somebody else has switched the lights."""
        self._lit = False

    def rest(self) -> None:
        """Lights dark until the next frame is asked for."""
        if self._lit:
            self._hardware.lights.dark()
            self._lit = False

    def wait_s(self) -> float:
        """How long until the next live frame is due, s: time to listen to the button."""
        since_s = (self._hardware.clock.monotonic_ns() - self._stepped_ns) * 1e-9
        return min(max(PERIOD_S - since_s, 0.0), PERIOD_S)

    def step(self) -> LiveFrame | None:
        """The next live frame and its reading; None while asleep.

        Raises
        ------
        HalError, FrameError
            Camera or lights do not answer, or frames of another kind come.
        """
        self._stepped_ns = self._hardware.clock.monotonic_ns()
        if self._plan is None or self._is_asleep():
            self.rest()
            self._board.change(live=None)
            return None
        if not self._lit:
            self._hardware.lights.switch_on(self._plan.currents_ma)
            self._lit = True
        camera = self._hardware.camera
        frame = after_restarts(camera, lambda: camera.next_frame(FRAME_TIMEOUT_S))
        check_frame(frame, self._hardware.profile.sensor, camera.camera_id)
        small = thin(frame)
        reading = self._coach.look(small)
        if not reading.in_air:
            self.wake()
        self._at_ns = small.at_ns
        self._board.change(live=LiveView(small.picture(), thinning(frame.shape), reading, small.at_ns))
        return LiveFrame(frame, reading)

    def fires(self, reading: CoachReading) -> bool:
        """Whether an auto-shutter fires now: once a contact, when it is still and nothing speaks against it."""
        if reading.in_air:
            self._fired = False
        if self._fired or reading.advice != "ready" or reading.still_s < STILL_S:
            return False
        self._fired = True
        return True

    def _is_asleep(self) -> bool:
        return self._hardware.clock.monotonic_ns() - self._awake_ns > ASLEEP_AFTER_S * 1e9
