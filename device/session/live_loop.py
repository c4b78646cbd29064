"""The live stream: lights on, one frame after the other to the coach; dark and asleep when nobody does anything."""

from __future__ import annotations

from typing import Final

from device.coaching.coach import Coach, CoachModel
from device.coaching.coach_reading import CoachReading
from device.coaching.thin_frame import ThinFrame, thin, thinning
from device.health_limits import STILL_S
from device.scanning.capture import FRAME_TIMEOUT_S, CapturePlan, check_frame
from device.session.noticeboard import Noticeboard
from device.session.state import LiveView
from hal.frame import RawFrame
from hal.hardware import Hardware

ASLEEP_AFTER_S: Final = 120.0
"""Without contact, press or command for so long the lights go dark: they warm the gel and eat the battery."""

DOZE_S: Final = 0.05


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
        self.frame: RawFrame | None = None
        self.thin_frame: ThinFrame | None = None

    def begin(self, plan: CapturePlan, model: CoachModel | None) -> None:
        """Stream with these settings from now on, and coach by this model."""
        self._hardware.camera.apply(plan.settings)
        self._plan = plan
        self._coach = Coach(model)
        self._lit = False
        self.wake()

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

    def step(self) -> CoachReading | None:
        """The reading of the next live frame; None while asleep.

        Raises
        ------
        HalError, FrameError
            Camera or lights do not answer, or frames of another kind come.
        """
        if self._plan is None or self._is_asleep():
            self.rest()
            self._hardware.clock.sleep(DOZE_S)
            self._board.change(live=None)
            return None
        if not self._lit:
            self._hardware.lights.switch_on(self._plan.currents_ma)
            self._lit = True
        camera = self._hardware.camera
        self.frame = camera.next_frame(FRAME_TIMEOUT_S)
        check_frame(self.frame, self._hardware.profile.sensor, camera.camera_id)
        self.thin_frame = thin(self.frame)
        reading = self._coach.look(self.thin_frame)
        if not reading.in_air:
            self.wake()
        step = thinning(self.frame.shape)
        self._board.change(live=LiveView(self.thin_frame.picture(), step, reading, self.thin_frame.at_ns))
        return reading

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
