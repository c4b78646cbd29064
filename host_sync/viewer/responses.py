"""Responses to the page: JSON with units in its names, and binary rows."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray
from starlette.responses import Response

from host_sync.csv_table import table_text
from host_sync.viewer.entry import Entry
from host_sync.viewer.profile import MeasuredLine
from host_sync.viewer.pyramid import Level

_FACTS: Final = (
    "name", "method", "calibration_id", "program", "written_utc", "calibration_passed", "masked_share",
    "height_sigma_median_um", "height_min_um", "height_max_um", "clipped_share", "frame_set", "reference",
    "shift_um", "turn_deg", "offset_um", "tilt", "residual_um", "median_um", "overlap_share", "agreement_share",
    "registered_by", "shift_sigma_um",
)  # fmt: skip
"""Fields of a record that the page shows."""


def json_answer(content: Any) -> Response:
    """JSON; NaN becomes null."""
    return Response(msgspec.json.encode(content), media_type="application/json", headers={"Cache-Control": "no-store"})


def binary_answer(data: bytes, facts: Mapping[str, int]) -> Response:
    """Bytes with integers in the headers."""
    headers = {f"X-{name}": str(value) for name, value in facts.items()} | {"Cache-Control": "no-store"}
    return Response(data, media_type="application/octet-stream", headers=headers)


def level_answer(level: Level) -> Response:
    """Rows of a level: half floats, then validity bytes."""
    rows, columns = level.valid.shape
    return binary_answer(level.surface.tobytes() + level.valid.tobytes(), {"Rows": rows, "Columns": columns})


def readable(text: str) -> str:
    """The text with `?` for each byte that is not valid UTF-8."""
    return text.encode(errors="replace").decode()


def entry_info(entry: Entry) -> dict[str, Any]:
    """An entry as the list shows it."""
    hit = entry.hit
    facts = {name: getattr(entry.record, name, None) for name in _FACTS}
    info: dict[str, Any] = {
        "key": entry.key,
        "kind": entry.kind,
        "title": readable(entry.title),
        "rows": entry.shape[0],
        "columns": entry.shape[1],
        "pitch_um": entry.pitch_um,
        "pages": entry.pages,
        "rate_hz": entry.rate_hz,
        "stamp": entry.stamp(),
        "place": readable(entry.folder.name if entry.scan else "/".join(entry.folder.parts[-2:])),
        "doubts": [readable(words) for words in entry.doubts],
        "record": {name: value for name, value in facts.items() if value not in (None, "", ())},
    }
    if hit is not None:
        info |= {
            "scan_id": hit.scan_id,
            "taken": hit.taken,
            "verdict": hit.verdict,
            "reason": hit.reason,
            "job": hit.job,
            "part": hit.part,
            "operator": hit.operator,
            "gel": hit.gel,
            "device": hit.device,
            "name": readable(hit.name),
            "tags": [readable(tag) for tag in hit.tags],
            "note": readable(hit.note),
        }
    return info


def profile_info(found: MeasuredLine, entry: Entry) -> dict[str, Any]:
    """A profile as lists; invalid samples are null."""
    ends = np.flatnonzero(np.isfinite(found.z_um))
    first, last = (int(ends[0]), int(ends[-1])) if ends.size else (0, 0)
    step = float(found.z_um[last] - found.z_um[first]) if ends.size else None
    return {
        "title": readable(entry.title),
        "doubts": [readable(words) for words in entry.doubts],
        "distance_um": found.along_um.tolist(),
        "z_um": _listed(found.z_um),
        "sigma_um": None if found.sigma_um is None else _listed(found.sigma_um),
        "ends": [first, last],
        "step_um": step,
        "step_sigma_um": found.difference_sigma_um(first, last) if ends.size else None,
    }


def profile_csv(found: MeasuredLine, entry: Entry) -> Response:
    """A profile as CSV; sigma is one standard uncertainty."""
    doubts = readable("; ".join(entry.doubts))
    sigma = np.full_like(found.z_um, np.nan) if found.sigma_um is None else found.sigma_um
    numbers = zip(found.rows, found.columns, found.along_um, found.z_um, sigma, strict=True)
    rows = [[*(float(f"{value:.9g}") for value in row), doubts] for row in numbers]
    names = ["row_px", "column_px", "distance_um", "height_um", "height_sigma_um", "doubts"]
    headers = {"Content-Disposition": f'attachment; filename="profile-{entry.key}.csv"', "Cache-Control": "no-store"}
    return Response(table_text([names, *rows]), media_type="text/csv; charset=utf-8", headers=headers)


def _listed(values: NDArray[np.float64]) -> list[float | None]:
    return [float(value) if np.isfinite(value) else None for value in values]
