"""Events of the instrument, in order; a front end reads them and draws, beeps or logs."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import Final, Literal

from device.acquisition.guided_calibration import CalibrationProgress
from device.acquisition.selftest import Finding
from device.bundles.scan import VerdictRecord
from device.surface import HeightMap
from hal.errors import HalError
from hal.hardware import Hardware
from hal.interfaces import Cue

RefusalReason = Literal["busy", "calibration", "full", "hardware"]


REFUSALS: Final[dict[RefusalReason, Cue]] = {
    "busy": "refused",
    "calibration": "refused: calibration",
    "full": "refused: full",
    "hardware": "refused: hardware",
}


@dataclass(frozen=True, slots=True)
class PressSeen:
    """A press was accepted; `latency_ms` since button-down (0 from a screen or the auto-shutter)."""

    at_ns: int
    latency_ms: float
    source: Literal["button", "screen", "auto-shutter"]


@dataclass(frozen=True, slots=True)
class CaptureDone:
    """The frame is in memory: the object may be lifted."""

    at_ns: int


@dataclass(frozen=True, slots=True, eq=False)
class ScanFinished:
    """A scan was judged and published. `height` is None without a quick look; `fault` then says why."""

    at_ns: int
    scan_id: str
    verdict: VerdictRecord
    height: HeightMap | None
    fault: str
    cpu_ms: float


@dataclass(frozen=True, slots=True)
class PressRefused:
    """A press was refused; the sentence says why and what to do."""

    at_ns: int
    reason: RefusalReason
    sentence: str


@dataclass(frozen=True, slots=True)
class Failed:
    """An operation failed; nothing half-done is left."""

    sentence: str


@dataclass(frozen=True, slots=True)
class Info:
    """A sentence for the operator."""

    sentence: str


@dataclass(frozen=True, slots=True)
class CalibrationStep:
    """The guided calibration went a step on; also in `InstrumentState.guide`."""

    progress: CalibrationProgress


@dataclass(frozen=True, slots=True)
class ZeroChecked:
    """Result of the zero check: how flat untouched skin reads (µm rms), and whether it passes."""

    flat_residual_um: float
    passed: bool
    sentence: str


@dataclass(frozen=True, slots=True)
class Checked:
    """The check standard was pressed: whether it passed, and the figures in a sentence."""

    passed: bool
    sentence: str


@dataclass(frozen=True, slots=True)
class CheckAsked:
    """A press of the check standard waits for an answer: whether the right ball lies on the gel."""

    question: str


@dataclass(frozen=True, slots=True)
class SelfTested:
    """A finding of the self-test; the last one has `ended`."""

    finding: Finding
    ended: bool


@dataclass(frozen=True, slots=True)
class PairingChanged:
    """The pairing window opened, shows a code, paired a workstation, or closed."""

    sentence: str
    is_open: bool


@dataclass(frozen=True, slots=True)
class ButtonPushed:
    """The button was pushed while it is redirected to a front end; no scan is taken."""

    held_long: bool


@dataclass(frozen=True, slots=True)
class PowerOffRequested:
    """The instrument is idle (lights off, everything stored): the machine may be switched off."""


Event = (
    PressSeen
    | CaptureDone
    | ScanFinished
    | PressRefused
    | Failed
    | Info
    | CalibrationStep
    | ZeroChecked
    | Checked
    | CheckAsked
    | SelfTested
    | PairingChanged
    | ButtonPushed
    | PowerOffRequested
)


def show(hardware: Hardware, cue: Cue) -> None:
    """Show a cue; an indicator that fails is ignored."""
    with suppress(HalError):
        hardware.indicator.show(cue)
