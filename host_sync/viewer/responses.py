"""Responses to the page: JSON with units in its names, and binary rows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray
from starlette.responses import Response

from device.surface import Float32Array, Float64Array
from host_sync.csv_table import table_text
from host_sync.errors import ViewError
from host_sync.profile.profile_line import Line, Profile, bilinear
from host_sync.viewer.cache import Level
from host_sync.viewer.entry import Entry

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
    """Return bytes with integers in the headers."""
    headers = {f"X-{name}": str(value) for name, value in facts.items()} | {"Cache-Control": "no-store"}
    return Response(data, media_type="application/octet-stream", headers=headers)


def level_answer(level: Level) -> Response:
    """Return rows of a level: half floats, then validity bytes."""
    rows, columns = level.valid.shape
    return binary_answer(level.surface.tobytes() + level.valid.tobytes(), {"Rows": rows, "Columns": columns})


def readable(text: str) -> str:
    """Return the text with `?` for each byte that is not valid UTF-8."""
    return text.encode(errors="replace").decode()


def entry_info(entry: Entry) -> dict[str, Any]:
    """Return an entry as the list shows it."""
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
    """Return a profile as lists; invalid samples are null."""
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
    """Return a profile as CSV; sigma is one standard uncertainty."""
    doubts = readable("; ".join(entry.doubts))
    sigma = np.full_like(found.z_um, np.nan) if found.sigma_um is None else found.sigma_um
    numbers = zip(found.rows, found.columns, found.along_um, found.z_um, sigma, strict=True)
    rows = [[*(float(f"{value:.9g}") for value in row), doubts] for row in numbers]
    names = ["row_px", "column_px", "distance_um", "height_um", "height_sigma_um", "doubts"]
    headers = {"Content-Disposition": f'attachment; filename="profile-{entry.key}.csv"', "Cache-Control": "no-store"}
    return Response(table_text([names, *rows]), media_type="text/csv; charset=utf-8", headers=headers)


def _listed(values: NDArray[np.float64]) -> list[float | None]:
    return [float(value) if np.isfinite(value) else None for value in values]


# Heights along a line, with their uncertainty.

MAX_POINTS: Final = 20_000
WHOLE_PX: Final = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredLine(Profile):
    """A profile from end to end of a line, in steps of at most one pixel.

    rows, columns : float64 arrays of shape (N,), places of the samples, px
    sigma_um : float64 array of shape (N,), standard uncertainty of each height above untouched skin; None if unknown
    samples_um : float64 array of shape (K, N), Monte Carlo samples of the error along the line; None if there are none
    """

    rows: Float64Array
    columns: Float64Array
    sigma_um: Float64Array | None
    samples_um: Float64Array | None

    def difference_sigma_um(self, first: int, last: int) -> float | None:
        """Return the standard uncertainty of z[last] - z[first]; None without samples.

        It is smaller than that of either, as most of their error is common.
        """
        if self.samples_um is None:
            return None
        return float(np.sqrt(np.mean((self.samples_um[:, last] - self.samples_um[:, first]) ** 2)))


def measure_line(
    z_um: Float32Array,
    pitch_um: float,
    line: Line,
    samples_um: Float32Array | None = None,
    sigma_um: Float32Array | None = None,
) -> MeasuredLine:
    """Return the profile along a line; along a row or a column it is the array itself.

    samples_um : float32 array of shape (K, h, w), samples of the height error on a reduced grid
    sigma_um : float32 array of shape (H, W), used where there are no samples

    Raises
    ------
    ViewError
        The line has no length, or leaves the height map.
    """
    shape = (z_um.shape[0], z_um.shape[1])
    rows, columns = _places(line, pitch_um, shape)
    places = np.stack([columns, rows], axis=-1)
    errors = None if samples_um is None else _drawn(samples_um, rows, columns, shape)
    if errors is not None:
        known = np.sqrt(np.mean(errors**2, axis=0))
    else:
        known = None if sigma_um is None else bilinear(sigma_um, places)[0]
    return MeasuredLine(
        z_um=bilinear(z_um, places)[0],
        step_um=line.length_um / (len(rows) - 1),
        rows=rows,
        columns=columns,
        sigma_um=known,
        samples_um=errors,
    )


def _places(line: Line, pitch_um: float, shape: tuple[int, int]) -> tuple[Float64Array, Float64Array]:
    """Return rows and columns of the samples, px."""
    ends = np.array([line.start_um, line.end_um]).T[::-1] / pitch_um
    whole = np.round(ends)
    ends = np.where(np.abs(ends - whole) < WHOLE_PX, whole, ends)
    if not np.isfinite(ends).all() or (ends < 0).any() or (ends.max(axis=1) > np.array(shape) - 1).any():
        raise ViewError("the profile leaves the height map: draw it inside")
    length_px = float(np.hypot(*(ends[:, 1] - ends[:, 0])))
    if not length_px > 0:
        raise ViewError("the profile has no length: draw it from one place to another")
    count = min(int(np.ceil(length_px - WHOLE_PX)) + 1, MAX_POINTS)
    rows, columns = (np.linspace(first, last, max(count, 2)) for first, last in ends)
    return rows, columns


def _drawn(samples_um: Float32Array, rows: Float64Array, columns: Float64Array, shape: tuple[int, int]) -> Float64Array:
    """Return the samples along the line: their cells cover several pixels each."""
    factor_rows, factor_columns = shape[0] / samples_um.shape[1], shape[1] / samples_um.shape[2]
    down = ((rows + 0.5) / factor_rows - 0.5).astype(np.float32)[None]
    right = ((columns + 0.5) / factor_columns - 0.5).astype(np.float32)[None]
    step = 4096  # cv2.remap takes at most 32767 places per line
    found = np.empty((len(samples_um), len(rows)))
    for sample_um, errors in zip(samples_um, found, strict=True):
        for first in range(0, len(rows), step):
            part = slice(first, first + step)
            errors[part] = cv2.remap(
                sample_um, right[:, part], down[:, part], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
            )[0]
    return found
