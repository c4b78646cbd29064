"""Contact of an object with the skin: where, how large, how deep, frame by frame; and slip of its texture.

Skin in contact stands high: an edge of contact lies near half of the largest height, as the edge of a spot near half of
its largest brightness.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

import cv2
import numpy as np

from device.surface import Float32Array, MaskArray
from hal.frame import RawFrame
from host_sync.csv_table import table_text
from host_sync.frame_checks.pigment_pattern import light_bands, weighted
from host_sync.frames.sequence import BadFrame, StoredFrame

if TYPE_CHECKING:
    from host_sync.video.stream import SolvedFrame

EDGE: Final = 0.5
"""Height of the contact's edge as a fraction of the largest."""

MIN_DEPTH_PX: Final = 0.5
MIN_DEPTH_SIGMAS: Final = 3.0
"""Largest height from which there is a contact, in pixel pitches and in standard uncertainties."""

WIDEST_PX: Final = 384
"""Columns of the field on which contact is found, at most."""

ROUGH_PX: Final = 3
"""Width of the median filter that keeps single pixels from being the largest height."""

MIN_CORRELATION: Final = 0.4
"""Correlation of the texture in two frames from which it is the same. Separate presses on skin without marks reach
0.12; noise lowers that of a moving one to 0.5."""

SURE_PX: Final = 32.0
"""Side of a contact that shows this correlation beyond chance; a smaller one must show more."""

MIN_CONTRAST: Final = 1e-4
"""Standard deviation of the fine band of a contact that shows a texture: rounding alone is below."""

ECC_ENDS: Final = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 1e-3)
"""Iterations of a translation, at most, and the increment of the correlation that ends them."""

COLUMNS: Final = (
    "frame", "time_s", "depth_um", "depth_sigma_um", "area_mm2", "area_sigma_mm2",
    "centre_column_px", "centre_row_px", "centre_sigma_px", "slip_right_um", "slip_down_um", "problem",
)  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Contact:
    """Contact in one frame; ± are standard uncertainties, None where that of heights is not known.

    mask : bool array of shape (h, w), over the field reduced
    area_mm2 : area of the contact; 0 where nothing touches
    centre : row and column of its middle, pixels of the frame; None where nothing touches
    depth_um : largest height; None where there is no height
    """

    mask: MaskArray
    area_mm2: float
    centre: tuple[float, float] | None
    depth_um: float | None
    area_sigma_mm2: float | None = None
    centre_sigma_px: float | None = None
    depth_sigma_um: float | None = None


def find_contact(height_um: Float32Array, pitch_um: float, sigma_um: Float32Array | None = None) -> Contact:
    """Return the contact that a height map shows, float32 arrays of shape (H, W), zero at untouched skin."""
    step = -(-height_um.shape[1] // WIDEST_PX)
    z = np.ascontiguousarray(np.nan_to_num(height_um[step // 2 :: step, step // 2 :: step]), np.float32)
    smooth = cv2.medianBlur(z, ROUGH_PX)
    top = np.unravel_index(int(smooth.argmax()), smooth.shape)
    depth_um = float(smooth[top])
    nowhere = np.zeros(z.shape, np.bool_)
    if not np.isfinite(height_um).any():
        return Contact(nowhere, 0.0, None, None)
    sigma = None if sigma_um is None else np.nan_to_num(sigma_um[step // 2 :: step, step // 2 :: step])
    depth_sigma = None if sigma is None else float(sigma[top])
    if depth_um < max(MIN_DEPTH_PX * pitch_um, MIN_DEPTH_SIGMAS * (depth_sigma or 0.0)):
        return Contact(nowhere, 0.0, None, depth_um, None, None, depth_sigma)
    cell_mm2 = (step * pitch_um * 1e-3) ** 2
    mask = smooth > EDGE * depth_um
    area, centre = _area(mask, step)
    if sigma is None:
        return Contact(mask, area * cell_mm2, centre, depth_um)
    (more, above), (less, below) = (_area(smooth + sign * sigma > EDGE * depth_um, step) for sign in (1.0, -1.0))
    # The scatter of edges adds up over neighbouring pixels, which err together.
    moved = 0.5 * float(np.hypot(above[0] - below[0], above[1] - below[1])) if less else 0.0
    return Contact(
        mask, area * cell_mm2, centre, depth_um, 0.5 * (more - less) * cell_mm2, float(np.hypot(moved, 0.5 * step)),
        depth_sigma,
    )  # fmt: skip


def _area(mask: MaskArray, step: int) -> tuple[int, tuple[float, float]]:
    """Return the number of cells of a mask, and row and column of their middle, pixels of the frame."""
    row, column = np.nonzero(mask)
    if not row.size:
        return 0, (0.0, 0.0)
    return row.size, (float(row.mean()) * step + step // 2, float(column.mean()) * step + step // 2)


class SlipTracker:
    """Displacement of the skin's own texture, or of marks on it, inside the contact since that began.

    Light counts by its fine band over that band's local variation, so that the object's shading, which stays, holds the
    texture back little. The translation between successive frames has the largest enhanced correlation coefficient
    (Evangelidis & Psarakis 2008); translations are summed. From a frame on that does not show the texture of the one
    before, or of which no height is known, the displacement is not known, until a new contact begins.
    """

    def __init__(self) -> None:
        self._before: Float32Array | None = None
        self._moved: tuple[float, float] | None = None

    def follow(self, light: Float32Array, contact: Contact) -> tuple[float, float] | None:
        """Return the displacement (down, right; pixels of `light`) up to a frame; None where it is not known.

        light : float32 array of shape (H, W), logarithm of light
        """
        if contact.depth_um is None:
            self._moved = None
            return None
        before, self._before = self._before, None if contact.centre is None else light
        if contact.centre is None:
            return None
        if before is None:
            self._moved = (0.0, 0.0)
        elif self._moved is not None:
            step = _translation(before, light, contact.mask)
            self._moved = None if step is None else (self._moved[0] + step[0], self._moved[1] + step[1])
        return self._moved


def _translation(before: Float32Array, light: Float32Array, mask: MaskArray) -> tuple[float, float] | None:
    """Return the translation (down, right; px) of fine texture inside a mask; None where the frames show no common one.

    before, light : float32 arrays of shape (H, W), logarithm of light
    mask : bool array of shape (h, w), over the field reduced
    """
    inside = cv2.resize(mask.astype(np.uint8), light.shape[::-1], interpolation=cv2.INTER_NEAREST)
    left, top, width, height = cv2.boundingRect(inside)
    box = (slice(top, top + height), slice(left, left + width))
    bands = [light_bands(np.ascontiguousarray(frame[box]))[0] for frame in (before, light)]
    if min(float(band.std()) for band in bands) < MIN_CONTRAST:
        return None
    one, other = (_evened(band) for band in bands)
    begin = np.eye(2, 3, dtype=np.float32)
    begin[:, 2] = cv2.phaseCorrelate(one, other)[0]
    try:
        correlation, found = cv2.findTransformECC(one, other, begin, cv2.MOTION_TRANSLATION, ECC_ENDS, inside[box], 1)
    except cv2.error:  # it does not converge
        return None
    right, down = (float(part) for part in found[:, 2])
    # Chance correlates the few pixels of a small contact.
    is_sure = correlation >= MIN_CORRELATION * max(1.0, SURE_PX / np.sqrt(np.count_nonzero(inside)))
    return (down, right) if is_sure and np.hypot(down, right) < 0.5 * min(width, height) else None


def _evened(band: Float32Array) -> Float32Array:
    """Return a band over its local standard deviation, arrays of the same shape."""
    scaled, weight = weighted(band)
    return np.asarray(scaled / np.sqrt(weight), np.float32)


@dataclass(frozen=True, slots=True)
class ContactRow:
    """One frame's line of the table of contact; None where nothing is known."""

    frame: int
    time_s: float
    depth_um: float | None = None
    depth_sigma_um: float | None = None
    area_mm2: float | None = None
    area_sigma_mm2: float | None = None
    centre_column_px: float | None = None
    centre_row_px: float | None = None
    centre_sigma_px: float | None = None
    slip_right_um: float | None = None
    slip_down_um: float | None = None
    problem: str = ""

    @classmethod
    def of(cls, solved: SolvedFrame, time_s: float, pitch_um: float, slip: SlipTracker | None = None) -> ContactRow:
        """Return the line of a frame; `slip` follows the skin's texture."""
        if solved.statistics is None:
            return cls(solved.number, time_s, problem=solved.reason or "")
        found = find_contact(solved.height_um, pitch_um, solved.sigma_um)
        row, column = found.centre or (None, None)
        light = None if slip is None or isinstance(solved.frame, BadFrame) else _log_light(solved.frame)
        moved = None if slip is None or light is None else slip.follow(light, found)
        down_um = right_um = None
        if light is not None and moved is not None:  # frames may be stored larger than heights
            sides = zip(moved, solved.height_um.shape, light.shape, strict=True)
            down_um, right_um = (part * pitch_um * side / stored for part, side, stored in sides)
        problems = ["no zero: heights are relative"] if solved.statistics.is_relative else []
        if light is not None and moved is None and found.centre is not None:
            problems.append("slip is not known: no texture is seen to move since the contact began")
        return cls(
            solved.number, time_s, found.depth_um, found.depth_sigma_um, found.area_mm2, found.area_sigma_mm2,
            column, row, found.centre_sigma_px, right_um, down_um, "; ".join(problems),
        )  # fmt: skip


def _log_light(frame: StoredFrame) -> Float32Array:
    """Return the logarithm of a frame's values, of green where it has colours: float32 array of shape (H, W)."""
    pixels = frame.pixels
    values = cv2.blur(pixels.mosaic.astype(np.float32), (2, 2)) if isinstance(pixels, RawFrame) else pixels[..., 1]
    return np.asarray(np.log1p(values, dtype=np.float32), np.float32)


def write_contact_table(path: Path, rows: Iterable[ContactRow]) -> None:
    """Write lines of contact as CSV; ± are standard uncertainties."""
    table = ([_six(getattr(row, name)) for name in COLUMNS] for row in rows)
    path.write_text(table_text([COLUMNS, *table]), encoding="utf-8", newline="")


def _six(value: object) -> object:
    """Return the value, a number to six digits."""
    return float(f"{value:.6g}") if isinstance(value, float) else value


def draw_contact_chart(path: Path, rows: list[ContactRow], title: str) -> None:
    """Draw depth, area and centre over time with their ±, as PNG or SVG by the name of the file."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 7.0), layout="constrained")
    axes = figure.subplots(3, 1, sharex=True)
    time_s = np.array([row.time_s for row in rows])
    panels = (
        ("Largest depth, µm", (("depth_um", "depth_sigma_um", "depth", "C0"),)),
        ("Contact area, mm²", (("area_mm2", "area_sigma_mm2", "area", "C1"),)),
        (
            "Centre, px",
            (
                ("centre_column_px", "centre_sigma_px", "column", "C2"),
                ("centre_row_px", "centre_sigma_px", "row", "C3"),
            ),
        ),
    )
    for axis, (label, lines) in zip(axes, panels, strict=True):
        for name, sigma_name, words, colour in lines:
            value, sigma = (np.array([_number(getattr(row, key)) for row in rows]) for key in (name, sigma_name))
            axis.plot(time_s, value, color=colour, label=words, linewidth=1.5, marker="." if len(rows) < 60 else None)
            if np.isfinite(sigma).any():
                axis.fill_between(time_s, value - sigma, value + sigma, color=colour, alpha=0.25, linewidth=0)
        axis.set_ylabel(label)
        axis.grid(alpha=0.3)
        if len(lines) > 1:
            axis.legend(loc="best", frameon=False)
    axes[0].set_title(title)
    axes[-1].set_xlabel("Time, s")
    figure.savefig(path, dpi=120)


def _number(value: float | None) -> float:
    return float("nan") if value is None else value
