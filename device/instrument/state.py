"""The instrument's state at one moment, as an immutable value, and the store that threads share it through."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace
from threading import Lock
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from device.acquisition.auto_exposure import ExposureBalance
from device.acquisition.capture import CaptureSettings
from device.acquisition.guided_calibration import CalibrationProgress
from device.bundles.check import CheckRecord, CheckStandard
from device.bundles.scan import Annotations, Retake, VerdictLevel, VerdictRecord
from device.guidance.cover_task import CoverMap
from device.guidance.guide import GuideReading
from device.imaging.frame_light import Brightness, SkinLevels
from device.imaging.frame_measures import FocusReading
from device.instrument.events import Event
from device.quality.press_faults import OLD_CALIBRATION_S
from device.store.choices import Settings
from device.surface import HeightMap
from hal.interfaces import PowerReading

Activity = Literal[
    "out of order", "ready", "capturing", "calibrating", "balancing", "checking zero", "self-test", "off"
]


@dataclass(frozen=True, slots=True, eq=False)
class LiveView:
    """The live image and the press guide's reading.

    picture : uint8 array of shape (h, w, 3), R, G, B
    step : sensor pixels per picture pixel, for drawing circles given in sensor pixels
    """

    picture: NDArray[np.uint8]
    step: int
    reading: GuideReading
    at_ns: int


@dataclass(frozen=True, slots=True)
class CalibrationState:
    """The active calibration, or why none is active (`fault` says what to do).

    version, slot : in the registry; None if unknown
    age_s : by the wall clock; None if negative, when that clock is wrong
    brightness : how much of the sensor's range it uses; None if not recorded
    """

    calibration_id: str | None = None
    gel_id: str | None = None
    version: int | None = None
    slot: Literal["factory", "user"] | None = None
    age_s: float | None = None
    held_out_deg: float | None = None
    brightness: Brightness | None = None
    fault: str = ""

    @property
    def is_old(self) -> bool:
        """True if it should be checked with the calibration cap."""
        return self.age_s is not None and self.age_s > OLD_CALIBRATION_S


@dataclass(frozen=True, slots=True)
class GelState:
    """The mounted gel and its number of presses."""

    gel_id: str
    slab_thickness_mm: float
    presses: int


@dataclass(frozen=True, slots=True)
class HealthState:
    """Changes of lights, reference and gel since calibration, as far as measured.

    light_change : relative change of each light, for example -0.03; None if not measured
    scans_unseen : scans since untouched skin was last measured
    reference_change : rms change of the untouched skin's pattern after removal of the light levels
    defect_fraction : fraction of the field with scratches, dust or stains; None if not measured
    flat_residual_um : of the last zero check
    level, sentence : "good" or "doubtful", and why
    """

    light_change: dict[str, float | None]
    scans_unseen: int = 0
    reference_change: float | None = None
    defect_fraction: float | None = None
    flat_residual_um: float | None = None
    level: VerdictLevel = "good"
    sentence: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class LastScan:
    """The last finished scan.

    height : its quick look; None without one, `fault` then says why
    """

    scan_id: str
    counter: int
    verdict: VerdictRecord
    height: HeightMap | None
    fault: str
    annotations: Annotations = field(default_factory=Annotations)


@dataclass(frozen=True, slots=True)
class CheckState:
    """The check standard and its checks.

    standard : None where none was entered
    checks : with the active calibration, oldest first
    is_due : today's check is due
    is_next : the next press is a check
    """

    standard: CheckStandard | None = None
    checks: tuple[CheckRecord, ...] = ()
    is_due: bool = False
    is_next: bool = False

    @property
    def of_standard(self) -> tuple[CheckRecord, ...]:
        """The checks of this standard, oldest first."""
        return tuple(one for one in self.checks if self.standard and one.standard == self.standard.identity)

    @property
    def failed_others(self) -> tuple[CheckRecord, ...]:
        """The last checks of other standards that failed."""
        last = {one.standard: one for one in self.checks}
        mine = self.standard.identity if self.standard else None
        return tuple(one for one in last.values() if not one.passed and one.standard != mine)


@dataclass(frozen=True, slots=True)
class BalanceProgress:
    """State of an exposure balance.

    phase, instruction : what to do now, one sentence; at the end what that means
    taken : presses so far, of one for each light
    found : before and after; None before its end
    """

    phase: Literal["press", "done", "failed"]
    instruction: str
    taken: int
    found: ExposureBalance | None = None


@dataclass(frozen=True, slots=True, eq=False)
class SpotState:
    """The search for an earlier scan's spot.

    height : that scan's quick look
    sentence : the way from the last touch
    way : the same as mm right, mm down and degrees clockwise; None: not known
    """

    scan_id: str
    counter: int
    height: HeightMap
    sentence: str
    is_reached: bool = False
    way: tuple[float, float, float] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class AreaState:
    """An area that is being covered by scans.

    map : what is covered; None before the first scan
    sentence : how much that is, and the way to the next press
    way : the same as mm right, mm down and degrees clockwise from the last press that was placed; None: not known
    """

    width_mm: float
    height_mm: float
    map: CoverMap | None
    sentence: str
    is_done: bool = False
    way: tuple[float, float, float] | None = None


@dataclass(frozen=True, slots=True)
class NextLight:
    """Exposure and currents of the next calibration, and whether they come from an exposure balance."""

    plan: CaptureSettings
    is_balanced: bool


@dataclass(frozen=True, slots=True)
class PairingState:
    """The pairing window, open or past.

    code : to compare with the workstation's; empty while none calls
    open_until_ns : end of the window by the instrument's clock
    sentence : what to do now, or how the window ended
    """

    code: str
    open_until_ns: int
    sentence: str
    is_open: bool


@dataclass(frozen=True, slots=True)
class InstrumentState:
    """Everything that a front end shows; replaced as a whole on every change.

    activity : presses are accepted in "ready", and in "calibrating" and "balancing" for their steps; "out of order"
        while a part does not answer: `sentence` says which, and the instrument retries by itself
    processing : scans in memory that are not on the disk yet
    sticky : job, part, operator and note of every scan
    settings : what the operator chose, such as how presses are taken
    scans_stored, scans_left : on the disk, and how many more fit; None if the disk cannot be read
    live_shown : whether a screen shows the live picture
    replaces : the scan that the next one is to replace; None: it is one more
    spot : the earlier scan whose spot is searched: pushes then compare, and store nothing; None: they scan
    area : that is being covered; None: scans stand for themselves
    focus : how sharp the lens is set, while a screen asks for it
    levels : light on the skin, while a screen asks for it
    balance : the exposure balance, or the last one; None: there was none since the start
    next_light : of the next calibration; None: not known yet
    alarms : supply, battery, root file system and room for scans, most urgent first
    sentence : the last message
    """

    activity: Activity
    board: str
    device_id: str
    calibration: CalibrationState
    gel: GelState
    health: HealthState
    sticky: Annotations = field(default_factory=Annotations)
    settings: Settings = field(default_factory=Settings)
    processing: int = 0
    scans_stored: int | None = None
    scans_left: int | None = None
    power: PowerReading = field(default_factory=PowerReading)
    alarms: tuple[str, ...] = ()
    auto_shutter: bool = False
    live_shown: bool = True
    live: LiveView | None = None
    last: LastScan | None = None
    replaces: Retake | None = None
    guide: CalibrationProgress | None = None
    pairing: PairingState | None = None
    check: CheckState = field(default_factory=CheckState)
    spot: SpotState | None = None
    area: AreaState | None = None
    focus: FocusReading | None = None
    levels: SkinLevels | None = None
    balance: BalanceProgress | None = None
    next_light: NextLight | None = None
    sentence: str = ""


class StateStore:
    """State and events of the instrument, shared between its threads and its front end; thread-safe."""

    def __init__(self, state: InstrumentState) -> None:
        self._lock = Lock()
        self._state = state
        self._events: deque[Event] = deque(maxlen=1000)

    @property
    def state(self) -> InstrumentState:
        """The present state: an immutable value."""
        return self._state

    def update(self, **fields: Any) -> None:
        """Replace some of the state's fields in one step."""
        with self._lock:
            self._state = replace(self._state, **fields)

    def count_stored(self, more: int) -> None:
        """Count scans that came or went on the disk."""
        with self._lock:
            stored = self._state.scans_stored
            self._state = replace(self._state, scans_stored=None if stored is None else max(stored + more, 0))

    def publish(self, event: Event) -> None:
        """Append an event."""
        self._events.append(event)

    def take_events(self) -> tuple[Event, ...]:
        """Return the events since the last call, oldest first; at most the last 1000 are kept."""
        taken = []
        while self._events:
            taken.append(self._events.popleft())
        return tuple(taken)


def status_summary(state: InstrumentState) -> str:
    """Return free space, battery and supply complaints in sentences, each after a blank."""
    room = "" if state.scans_left is None else f" Room for {state.scans_left} scans."
    battery = "" if state.power.battery_share is None else f" Battery {state.power.battery_share:.0%}."
    return (
        room
        + battery
        + "".join(f" {alarm}." for alarm in state.alarms)
        + "".join(f" {complaint}." for complaint in state.power.complaints)
    )
