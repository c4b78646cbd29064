"""What is wanted of a sequence, what became of it, and what `result.json` says of that."""

from __future__ import annotations

import time
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any, Final

from host_sync.calibration.full_calibration import Calibration
from host_sync.reconstruction.frame_solver import FrameFigures, FrameSolver
from host_sync.reconstruction.sequence_movie import SeenRelief

SCHEMA: Final = "retrograph.sequence/1"
HEIGHTS_FILE: Final = "heights_um.tif"
DEFAULT_RATE_HZ: Final = 25.0


@dataclass(frozen=True, slots=True)
class FrameOutcome:
    """One frame of the sequence: its figures, or the sentence that says why it has none."""

    name: str
    figures: FrameFigures | None
    reason: str | None = None


@dataclass(frozen=True, slots=True)
class SequenceReport:
    """What became of a sequence.

    heights_per_s, pictures_per_s : frames a second from file to height on disk, and from there to the movie
    """

    outcomes: tuple[FrameOutcome, ...]
    rate_hz: float
    heights_per_s: float
    pictures_per_s: float | None

    @property
    def failures(self) -> tuple[FrameOutcome, ...]:
        """The frames that have no height map."""
        return tuple(outcome for outcome in self.outcomes if outcome.figures is None)


@dataclass(frozen=True, slots=True)
class SequenceOrder:
    """What is wanted of a sequence.

    name : for titles and the record
    rate_hz : frames a second; None takes the source's own, else `DEFAULT_RATE_HZ`
    mp4, gif : which movies to write
    facts : more entries for `result.json`
    """

    name: str
    rate_hz: float | None = None
    mp4: bool = True
    gif: bool = True
    facts: tuple[tuple[str, Any], ...] = ()


def sequence_record(
    report: SequenceReport, calibration: Calibration, solver: FrameSolver, seen: SeenRelief, order: SequenceOrder
) -> dict[str, Any]:
    """What `result.json` says: units are in the names, missing readings are null."""
    rows, columns = solver.shape
    return {
        "schema": SCHEMA,
        "name": order.name,
        "program": f"retrograph {version('retrograph')}",
        "written_utc": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        "calibration_id": calibration.calibration_id,
        "rows": rows,
        "columns": columns,
        "pixel_pitch_um": calibration.pitch_um,
        "rate_hz": report.rate_hz,
        "heights": f"{HEIGHTS_FILE}: a page per frame, µm, NaN is invalid",
        "height_zero": "median of untouched skin, in every frame",
        "colour_range_um": [seen.low_um, seen.high_um],
        "heights_per_s": report.heights_per_s,
        "pictures_per_s": report.pictures_per_s,
        **solver.facts,
        **dict(order.facts),
        "frames": [_frame_record(number, outcome, report.rate_hz) for number, outcome in enumerate(report.outcomes)],
    }


def _frame_record(number: int, outcome: FrameOutcome, rate_hz: float) -> dict[str, Any]:
    record: dict[str, Any] = {"page": number, "name": outcome.name, "time_s": number / rate_hz}
    if outcome.figures is None:
        return record | {"failed": outcome.reason}
    return record | {
        "contact_share": outcome.figures.contact_share,
        "clipped_share": outcome.figures.clipped_share,
        "masked_share": outcome.figures.masked_share,
        "peak_um": outcome.figures.peak_um,
    }
