"""Responses to the page: JSON with units in its names, binary rows, and pictures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray
from starlette.responses import Response

from device.bundles.scan import read_scan
from device.errors import DeviceError
from device.imaging.flat_field import demosaic
from device.surface import Float32Array, Float64Array
from host_sync.csv_table import table_text
from host_sync.errors import HostError, ViewError
from host_sync.frames.frame_set import ScanSpec
from host_sync.frames.linear_light import read_frame
from host_sync.profile.profile_line import Line, Profile, bilinear
from host_sync.render.shading import HIGHLIGHT, tint_table
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


THUMBNAIL_PX: Final = 384
FRAME_PX: Final = 4096
SIGMA_PX: Final = 768
_LIGHT: Final = (-0.5417, -0.5417, 0.6428)
_AMBIENT: Final = 0.15
_WHITE_PERCENTILE: Final = 99.7


def thumbnail(z_um: Float32Array, pitch_um: float) -> bytes:
    """Return a small relief as WebP, shaded from the upper left, transparent where invalid."""
    factor = max(1, int(np.ceil(max(z_um.shape) / THUMBNAIL_PX)))
    size = (max(2, z_um.shape[1] // factor), max(2, z_um.shape[0] // factor))
    small = cv2.resize(z_um, size, interpolation=cv2.INTER_AREA)
    q, p = np.gradient(small / np.float32(pitch_um * factor))
    steep = np.nan_to_num(np.hypot(p, q))
    p, q = (slope * max(1.0, 0.35 / max(float(np.percentile(steep, 97.0)), 0.35 / 20.0)) for slope in (p, q))
    light = (_LIGHT[2] - p * _LIGHT[0] - q * _LIGHT[1]) / np.sqrt(1.0 + p * p + q * q)
    brightness = _AMBIENT + (1.0 - _AMBIENT) * np.clip(light, 0.0, None)
    known = np.isfinite(brightness) & np.isfinite(small)  # a central difference ignores its own pixel
    low, high = np.percentile(small[known], [0.1, 99.9]) if known.any() else (0.0, 1.0)
    share = np.clip((np.nan_to_num(small, nan=low) - low) / max(high - low, 1e-3), 0.0, 1.0)
    colour = tint_table()[np.round(share * 255.0).astype(int)]
    flat = _AMBIENT + (1.0 - _AMBIENT) * _LIGHT[2]
    brightness = np.nan_to_num(brightness, nan=flat)[..., None]
    shaded = colour * np.minimum(brightness / flat, 1.0)
    shaded += (255.0 - shaded) * HIGHLIGHT * np.clip(brightness - flat, 0.0, None) / (1.0 - flat)
    picture = np.dstack([shaded[..., ::-1], np.where(known, 255.0, 0.0)])
    return _encoded(".webp", np.round(picture).astype(np.uint8), cv2.IMWRITE_WEBP_QUALITY, 88)


def frame_picture(entry: Entry, spec: ScanSpec | None) -> bytes:
    """Return the frame that a height map was made from, as JPEG.

    spec : the scan of the named frame set, for results outside a library

    Raises
    ------
    ViewError
        There is no frame, or it is damaged.
    """
    try:
        if entry.scan is not None:
            rgb = demosaic(read_scan(entry.scan).raw_frame()).rgb
        elif spec is not None:
            rgb = read_frame(spec.frame).rgb
        else:
            raise ViewError(f"{entry.title}: its frame is not known: name its frame set with --frames FRAMESET.toml")
    except (DeviceError, HostError) as error:
        raise ViewError(str(error)) from error
    factor = max(1, int(np.ceil(max(rgb.shape[:2]) / FRAME_PX)))
    if factor > 1:
        size = (rgb.shape[1] // factor, rgb.shape[0] // factor)
        rgb = np.asarray(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA), np.float32)
    return _encoded(".jpg", _display_rgb(rgb)[..., ::-1], cv2.IMWRITE_JPEG_QUALITY, 92)


def grey_frames(first: Entry, second: Entry) -> tuple[Float32Array, Float32Array] | None:
    """Grey frames of two scans of one gel at the pixels of their height maps; None where they are not both known."""
    if first.scan is None or second.scan is None or first.shape != second.shape:
        return None
    try:
        scans = [read_scan(scan) for scan in (first.scan, second.scan)]
        if scans[0].record.gel_id != scans[1].record.gel_id:
            return None
        greys = [demosaic(scan.raw_frame()).rgb.mean(axis=-1) for scan in scans]
    except (DeviceError, HostError):
        return None  # the texture is one of several starts: a damaged frame costs no more than that
    size = first.shape[::-1]
    one, other = (np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), np.float32) for grey in greys)
    return one, other


def _display_rgb(rgb: Float32Array) -> NDArray[np.uint8]:
    """sRGB of linear light, scaled to the full range."""
    white = max(float(np.percentile(rgb[::7, ::7], _WHITE_PERCENTILE)), 1e-6)
    steps = np.clip(rgb / white, 0.0, 1.0) * np.float32(4095.0)
    linear = np.arange(4096) / 4095.0
    curve = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1.0 / 2.4) - 0.055)
    shown: NDArray[np.uint8] = np.round(255.0 * curve).astype(np.uint8)[steps.astype(np.uint16)]
    return shown


def sigma_picture(sigma_um: Float32Array) -> Float32Array:
    """Return the reduced uncertainty map: float32 array of shape (h, w), µm; NaN where unknown."""
    factor = max(1, int(np.ceil(max(sigma_um.shape) / SIGMA_PX)))
    size = (max(1, sigma_um.shape[1] // factor), max(1, sigma_um.shape[0] // factor))
    known = np.isfinite(sigma_um).astype(np.float32)
    share = cv2.resize(known, size, interpolation=cv2.INTER_AREA)
    total = cv2.resize(np.where(known > 0, sigma_um, np.float32(0.0)), size, interpolation=cv2.INTER_AREA)
    return np.where(share > 0, total / np.maximum(share, np.float32(1e-6)), np.float32(np.nan)).astype(np.float32)


def _encoded(form: str, picture: NDArray[np.uint8], setting: int, quality: int) -> bytes:
    _, data = cv2.imencode(form, picture, [setting, quality])
    return data.tobytes()
