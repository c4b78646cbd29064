"""The live stream: lights on, frame after frame to the press guide; lights off after a while without activity."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Literal

from device.acquisition.capture import FRAME_TIMEOUT_S, CaptureSettings, check_frame
from device.bundles.scan import VerdictLevel
from device.guidance.guide import GuideModel, GuideReading, PressGuide, downsample_bayer, downsample_step
from device.imaging.frame_light import Levels, SkinLevels
from device.imaging.frame_measures import FocusMeter, FocusReading
from device.instrument.events import Info
from device.instrument.state import LiveView, StateStore
from device.quality.press_faults import STILL_S
from hal.errors import FrameTimeout
from hal.frame import RawFrame
from hal.hardware import Hardware
from hal.interfaces import Clock

SLEEP_AFTER_S: Final = 120.0
"""Time without contact, press or command after which the lights go off: they warm the gel and drain the battery."""

PERIOD_S: Final = 0.05
"""Interval of live frames; between them the worker waits for the button."""

UNSEEN_PERIOD_S: Final = 0.25
"""The same while no screen shows the live picture, or the lights are off: processor time costs battery."""

LIVE_TIMEOUT_S: Final = 0.8
"""A camera that delivers no further live frame within this time is reported and reopened; the first may take longer."""

MAX_MOTION_AGE_S: Final = 0.5
"""Maximum age of the live frame that a scan's motion is measured against."""


@dataclass(frozen=True, slots=True, eq=False)
class LiveFrame:
    """A full frame of the live stream, and its reading."""

    frame: RawFrame
    reading: GuideReading


class LiveLoop:
    """The live stream of one instrument; for the hardware's thread only."""

    def __init__(self, hardware: Hardware, states: StateStore) -> None:
        self._hardware = hardware
        self._states = states
        self._plan: CaptureSettings | None = None
        self._guide = PressGuide(None)
        self._lit = self._has_delivered = False
        self._awake_ns = hardware.clock.monotonic_ns()
        self._fired = False
        self._stepped_ns = 0
        self._at_ns: int | None = None

    def begin(self, plan: CaptureSettings, model: GuideModel | None) -> None:
        """Stream with these settings from now on, and guide with this model."""
        self._hardware.camera.apply(plan.settings)
        self._plan = plan
        self._guide = PressGuide(model)
        self._lit = self._has_delivered = False
        self.wake()

    def set_light_levels(self, levels: Levels, drift: tuple[VerdictLevel, str] | None) -> None:
        """Correct for untouched skin's levels in R, G, B relative to the reference; `drift` says which light is off."""
        self._guide.set_light_levels(levels, drift)

    def motion(self, frame: RawFrame) -> float | None:
        """Return how much a frame differs from the last live one; None if that is too old."""
        at_ns = self._at_ns
        if at_ns is None or frame.sensor_timestamp_ns - at_ns > MAX_MOTION_AGE_S * 1e9:
            return None
        return self._guide.motion(downsample_bayer(frame))

    def wake(self) -> None:
        """Restart the time to sleep, after any activity."""
        self._awake_ns = self._hardware.clock.monotonic_ns()

    def lights_changed(self) -> None:
        """Switch the lights on again in the next step, for other code switched them."""
        self._lit = False

    def rest(self) -> None:
        """Switch the lights off until the next frame."""
        if self._lit:
            self._hardware.lights.off()
            self._lit = False

    def wait_s(self) -> float:
        """Return the time until the next live frame is due, s, in which the worker may wait for the button."""
        since_s = (self._hardware.clock.monotonic_ns() - self._stepped_ns) * 1e-9
        period_s = self._period_s()
        return min(max(period_s - since_s, 0.0), period_s)

    def step(self) -> LiveFrame | None:
        """Return the next live frame and its reading; None while asleep.

        Raises
        ------
        HalError, FrameError
            Camera or lights do not answer, or frames differ from the board profile.
        """
        self._stepped_ns = self._hardware.clock.monotonic_ns()
        if self._plan is None or self.is_asleep():
            self.rest()
            self._states.update(live=None)
            return None
        if not self._lit:
            self._hardware.lights.switch_on(self._plan.currents_ma)
            self._lit = True
        camera = self._hardware.camera
        try:
            frame = camera.next_frame(LIVE_TIMEOUT_S if self._has_delivered else FRAME_TIMEOUT_S)
        except FrameTimeout as error:
            sentence = (
                f"camera {camera.camera_id} delivers no frame: check its ribbon cable at both ends and its supply"
            )
            raise FrameTimeout(sentence) from error
        self._has_delivered = True
        check_frame(frame, self._hardware.profile.sensor, camera.camera_id)
        small = downsample_bayer(frame)
        reading = self._guide.read(small)
        if not reading.in_air:
            self.wake()
        self._at_ns = small.at_ns
        self._states.update(live=LiveView(small.picture(), downsample_step(frame.shape), reading, small.at_ns))
        return LiveFrame(frame, reading)

    def fires(self, reading: GuideReading) -> bool:
        """Return whether the auto-shutter fires now: once per contact, when it is still and the guide says ready."""
        if reading.in_air:
            self._fired = False
        if self._fired or reading.advice != "ready" or reading.still_s < STILL_S:
            return False
        self._fired = True
        return True

    def _period_s(self) -> float:
        """Return the interval of live frames: slow while nobody waits for one."""
        state = self._states.state
        waits = state.live_shown or state.processing > 0 or state.auto_shutter or state.focus is not None
        return PERIOD_S if waits and not self.is_asleep() else UNSEEN_PERIOD_S

    def is_asleep(self) -> bool:
        """Return whether the lights are off because nothing has happened for a while.

        The next push then only switches them on.
        """
        return self._hardware.clock.monotonic_ns() - self._awake_ns > SLEEP_AFTER_S * 1e9


# A figure of every live frame that a screen asks for, such as the focus; it ends by itself after a while.

MAX_READING_S: Final = 600.0
"""Maximum time: the lights stay on meanwhile, which warms the gel."""

Read = Callable[[RawFrame], FocusReading | SkinLevels]


class LiveFigure:
    """Reads a figure of live frames between `start` and `stop`; for the hardware's thread only.

    Parameters
    ----------
    field : of the state, where the figure is shown
    begin : returns what reads frames; called at every start
    ended : what is said when it ends by itself
    """

    def __init__(
        self,
        states: StateStore,
        live: LiveLoop,
        clock: Clock,
        field: Literal["focus", "levels"],
        begin: Callable[[], Read],
        ended: str,
    ) -> None:
        self._states = states
        self._live = live
        self._clock = clock
        self._field = field
        self._begin = begin
        self._ended = ended
        self._read: Read | None = None
        self._started_ns = 0

    def start(self) -> None:
        """Read from now on; what was seen before is forgotten."""
        self._read, self._started_ns = self._begin(), self._clock.monotonic_ns()
        self._live.wake()

    def stop(self) -> None:
        """Read no longer."""
        self._read = None
        self._states.update(**{self._field: None})

    def step(self, live: LiveFrame | None) -> None:
        """Read a live frame, if the figure is wanted and there is one."""
        if self._read is None:
            return
        if self._clock.monotonic_ns() - self._started_ns > MAX_READING_S * 1e9:
            self.stop()
            self._states.publish(Info(f"{self._ended} ended after {MAX_READING_S / 60.0:.0f} minutes."))
            return
        self._live.wake()
        if live is not None:
            self._states.update(**{self._field: self._read(live.frame)})


def focus_figure_of(states: StateStore, live: LiveLoop, clock: Clock) -> LiveFigure:
    """Return how sharp the lens is set, while a person turns it."""
    return LiveFigure(states, live, clock, "focus", lambda: FocusMeter().read, "The focus figure")


def skin_levels_of(states: StateStore, live: LiveLoop, clock: Clock) -> LiveFigure:
    """Return how bright each light is on the skin."""
    return LiveFigure(states, live, clock, "levels", lambda: SkinLevels.of_frame, "Reading the light on the skin")
