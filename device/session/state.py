"""What the instrument is at one moment: an immutable picture of it that any thread may read."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from device.coaching.coach_reading import CoachReading
from device.exposure_levels import Brightness
from device.health_limits import OLD_CALIBRATION_S
from device.scan_bundle import Annotations, VerdictLevel, VerdictRecord
from device.scanning.guided_calibration import CalibrationProgress
from device.surface import HeightMap
from hal.interfaces import PowerReading

Activity = Literal["out of order", "ready", "capturing", "calibrating", "checking zero", "self-test", "off"]


@dataclass(frozen=True, slots=True, eq=False)
class LiveView:
    """The live picture and what the coach says of it.

    picture : uint8 array of shape (h, w, 3), R, G, B
    step : sensor pixels per picture pixel, so that circles in sensor pixels can be drawn on it
    """

    picture: NDArray[np.uint8]
    step: int
    reading: CoachReading
    at_ns: int


@dataclass(frozen=True, slots=True)
class CalibrationState:
    """The calibration in force, or why none is (`fault` says what to do next).

    version, slot : of the calibration among those for this instrument, gel and lights; None when unknown
    age_s : by the wall clock, which may be wrong; None when it says something impossible
    brightness : how much of the sensor's range it uses; None when it does not say
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
        """Whether it is worth a check with the cap."""
        return self.age_s is not None and self.age_s > OLD_CALIBRATION_S


@dataclass(frozen=True, slots=True)
class GelState:
    """The gel that is mounted, as the instrument was told, and how often it was pressed."""

    gel_id: str
    slab_thickness_mm: float
    presses: int


@dataclass(frozen=True, slots=True)
class HealthState:
    """Lights, reference and gel since calibration, as far as they could be seen.

    light_change : by light, relative change of its level, such as -0.03; None when untouched skin was not seen
    scans_unseen : scans since untouched skin was last seen
    reference_change : root mean square change of the resting skin's pattern, lights' levels taken out
    defect_share : share of the field under scratches, dust or stains; None before a look
    flat_residual_um : of the last zero check
    level, sentence : "good" or "doubtful", and why
    """

    light_change: dict[str, float | None]
    scans_unseen: int = 0
    reference_change: float | None = None
    defect_share: float | None = None
    flat_residual_um: float | None = None
    level: VerdictLevel = "good"
    sentence: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class LastScan:
    """The scan that was finished last.

    height : its quick look; None when there is none, and `fault` says why
    """

    scan_id: str
    counter: int
    verdict: VerdictRecord
    height: HeightMap | None
    fault: str


@dataclass(frozen=True, slots=True)
class PairingState:
    """The pairing window: the code to type on the workstation, until when (ns of the instrument's clock), or how it
    ended."""

    code: str
    open_until_ns: int
    sentence: str
    is_open: bool


@dataclass(frozen=True, slots=True)
class InstrumentState:
    """Everything a face shows; replaced as a whole whenever something changes.

    activity : what the instrument is at; presses are taken in "ready" alone (and in "calibrating", for its steps);
        "out of order" while a part does not answer: `sentence` says which, and it is tried again by itself
    processing : scans whose frame is in memory and that are not yet on the disk
    sticky : job, part, operator and note that every scan gets
    scans_stored, scans_left : on the disk, and how many more fit; None when the disk cannot be asked
    sentence : the last thing worth telling
    """

    activity: Activity
    board: str
    device_id: str
    calibration: CalibrationState
    gel: GelState
    health: HealthState
    sticky: Annotations = field(default_factory=Annotations)
    processing: int = 0
    scans_stored: int | None = None
    scans_left: int | None = None
    power: PowerReading = field(default_factory=PowerReading)
    auto_shutter: bool = False
    live: LiveView | None = None
    last: LastScan | None = None
    guide: CalibrationProgress | None = None
    pairing: PairingState | None = None
    sentence: str = ""
