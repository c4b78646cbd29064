"""What happened, in order: a face drains these and draws, beeps or logs as it likes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from device.scan_bundle import VerdictRecord
from device.scanning.guided_calibration import CalibrationProgress
from device.scanning.selftest import Finding
from device.surface import HeightMap

RefusalReason = Literal["busy", "calibration", "full", "hardware"]


@dataclass(frozen=True, slots=True)
class PressSeen:
    """A press was taken; `latency_ms` since the button went down (0 from a screen or the auto-shutter)."""

    at_ns: int
    latency_ms: float
    source: Literal["button", "screen", "auto-shutter"]


@dataclass(frozen=True, slots=True)
class MayLift:
    """The frame is in memory: the object may be lifted."""

    at_ns: int


@dataclass(frozen=True, slots=True, eq=False)
class ScanFinished:
    """A scan is published and judged. `height` is None when there is no quick look, and `fault` says why."""

    at_ns: int
    scan_id: str
    verdict: VerdictRecord
    height: HeightMap | None
    fault: str
    cpu_ms: float


@dataclass(frozen=True, slots=True)
class PressRefused:
    """A press did nothing: why, and what to do next."""

    at_ns: int
    reason: RefusalReason
    sentence: str


@dataclass(frozen=True, slots=True)
class Failed:
    """Something that was begun did not succeed; nothing half-done is left."""

    sentence: str


@dataclass(frozen=True, slots=True)
class Told:
    """A sentence for whoever watches."""

    sentence: str


@dataclass(frozen=True, slots=True)
class CalibrationStep:
    """The guided calibration moved on; also in `InstrumentState.guide`."""

    progress: CalibrationProgress


@dataclass(frozen=True, slots=True)
class ZeroChecked:
    """The zero check in air: how flat untouched skin reads (µm rms), and whether that passes."""

    flat_residual_um: float
    passed: bool
    sentence: str


@dataclass(frozen=True, slots=True)
class SelfTested:
    """One finding of the self-test; the last has `ended`."""

    finding: Finding
    ended: bool


@dataclass(frozen=True, slots=True)
class PairingChanged:
    """The pairing window opened, paired or closed."""

    sentence: str
    is_open: bool


@dataclass(frozen=True, slots=True)
class ButtonPushed:
    """The button is lent to a face and was pushed; no scan came of it."""

    held_long: bool


@dataclass(frozen=True, slots=True)
class PowerOffAsked:
    """The instrument has come to rest (lights dark, nothing unwritten): the machine may be switched off."""


Event = (
    PressSeen
    | MayLift
    | ScanFinished
    | PressRefused
    | Failed
    | Told
    | CalibrationStep
    | ZeroChecked
    | SelfTested
    | PairingChanged
    | ButtonPushed
    | PowerOffAsked
)
