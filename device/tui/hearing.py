"""What an event is worth saying in the notice line."""

from __future__ import annotations

from device.session.events import (
    CalibrationStep,
    Event,
    Failed,
    MayLift,
    PairingChanged,
    PressRefused,
    ScanFinished,
    Told,
    ZeroChecked,
)
from device.tui.notice import Notice


def notice_of(event: Event) -> Notice | None:
    """The notice that an event asks for; None leaves the last one standing."""
    match event:
        case MayLift():
            return Notice("You may lift.", "done")
        case PressRefused(sentence=sentence):
            return Notice(f"Nothing was scanned: {sentence}", "failed")
        case Failed(sentence=sentence):
            return Notice(sentence, "failed")
        case Told(sentence=sentence):
            return Notice(sentence)
        case ZeroChecked(passed=passed, sentence=sentence):
            return Notice(sentence, "done" if passed else "failed")
        case PairingChanged(sentence=sentence):
            return Notice(sentence)
        case CalibrationStep(progress=progress) if progress.phase == "passed":
            return Notice(progress.instruction, "done")
        case CalibrationStep(progress=progress) if progress.phase == "failed":
            return Notice(progress.instruction, "failed")
        case ScanFinished(fault=fault) if fault:
            return Notice(f"The scan is stored, without a quick look: {fault}", "failed")
        case _:
            return None
