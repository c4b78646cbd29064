"""Contact of an object with the skin: where, how large, how deep, frame by frame; and slip, by optical flow.

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
from numpy.typing import NDArray

from device.surface import Float32Array, MaskArray
from hal.frame import RawFrame
from host_sync.csv_table import table_text
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

    The displacement is the median over the contact of a dense optical flow (OpenCV's DIS) from frame to frame, summed.
    """

    def __init__(self) -> None:
        self._flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
        self._before: NDArray[np.uint8] | None = None
        self._down = self._right = 0.0

    def follow(self, grey: NDArray[np.uint8], contact: Contact) -> tuple[float, float] | None:
        """Return the displacement (down, right; pixels of the frame) up to a frame; None where nothing touches.

        grey : uint8 array of shape (H, W)
        """
        before, self._before = self._before, grey
        if contact.centre is None:
            self._down = self._right = 0.0
            return None
        if before is not None:
            flow = self._flow.calc(before, grey, np.zeros((*grey.shape, 2), np.float32))
            inside = cv2.resize(contact.mask.astype(np.uint8), grey.shape[::-1], interpolation=cv2.INTER_NEAREST) > 0
            right, down = np.median(flow[inside], axis=0) if inside.any() else (0.0, 0.0)
            self._down, self._right = self._down + float(down), self._right + float(right)
        return self._down, self._right


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
        moved = None if slip is None or isinstance(solved.frame, BadFrame) else slip.follow(_grey(solved.frame), found)
        down_um, right_um = (None, None) if moved is None else (part * pitch_um for part in moved)
        return cls(
            solved.number, time_s, found.depth_um, found.depth_sigma_um, found.area_mm2, found.area_sigma_mm2,
            column, row, found.centre_sigma_px, right_um, down_um,
            "no zero: heights are relative" if solved.statistics.is_relative else "",
        )  # fmt: skip


def _grey(frame: StoredFrame) -> NDArray[np.uint8]:
    """Return the green picture of a frame, brought to its brightest pixels."""
    pixels = frame.pixels.mosaic if isinstance(frame.pixels, RawFrame) else frame.pixels[..., 1]
    values = cv2.blur(pixels.astype(np.float32), (2, 2)) if isinstance(frame.pixels, RawFrame) else pixels
    return np.asarray(
        np.clip(values * (255.0 / max(float(np.percentile(values[::8, ::8], 99.9)), 1.0)), 0, 255), np.uint8
    )


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
