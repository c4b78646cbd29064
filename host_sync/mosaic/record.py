"""`mosaic.json`: where the presses of a mosaic lie, what links them, and what was rejected."""

from __future__ import annotations

from typing import Final

import msgspec

MOSAIC_SCHEMA: Final = "retrograph.mosaic/1"
MOSAIC_FILE: Final = "mosaic.json"


class PlaceRecord(msgspec.Struct, frozen=True, kw_only=True):
    """Place of a press in the mosaic, and the plane that was added to it.

    row_px, column_px : its middle, px of the mosaic from the middle of the first pixel
    turn_deg : of the press, clockwise on the screen
    sigma_um : standard uncertainty of its place relative to the press at the root
    added_um, added_slope : height at its middle, and slopes along columns and rows (µm/µm)
    """

    name: str
    row_px: float
    column_px: float
    turn_deg: float
    sigma_um: float
    added_um: float
    added_slope: tuple[float, float]


class LinkRecord(msgspec.Struct, frozen=True, kw_only=True):
    """Relative place of two presses; None where it was not found.

    down_um, right_um, turn_deg : of the object from the first to the second
    sigma_um : standard uncertainty of the shift at the overlap, along the direction that is known least
    agreement : correlation of the slopes over the overlap
    overlap_share : overlap as a fraction of the first press
    stretch : by how much the second is larger than the first, relative
    loops : loops of three or four presses that it closes
    used : whether the mosaic holds to it
    rejected : why it does not, one clause
    residual_um, residual_sigmas : how far the places of the mosaic are from it
    seam_um, seam_sigmas : root mean square of what lies between both heights over the overlap
    seam_beyond_2_sigmas : share of the overlap that differs by more than 2 σ
    """

    first: str
    second: str
    down_um: float
    right_um: float
    turn_deg: float
    sigma_um: float | None
    agreement: float
    overlap_share: float
    stretch: float | None = None
    loops: int = 0
    used: bool = False
    rejected: str = ""
    residual_um: float | None = None
    residual_sigmas: float | None = None
    seam_um: float | None = None
    seam_sigmas: float | None = None
    seam_beyond_2_sigmas: float | None = None


class MosaicRecord(msgspec.Struct, frozen=True, kw_only=True):
    """Record of a mosaic.

    root : the press that uncertainties of places are relative to
    left_out : presses that no link joins to the others
    unusable : a sentence for each press that was asked for and has no results, or none that can be read
    stretch_median : median of the links' stretch, and the median of its absolute value; None without links
    span_um, span_sigma_um : distance of the two presses farthest apart, and its standard uncertainty from the links
    covered_share : fraction of the mosaic's pixels with a height
    period_um : distance after which the relief repeats itself, where places may be off by it; else None
    without_sigma : presses that state no uncertainty of their heights; with one of them the mosaic has none
    """

    schema: str = MOSAIC_SCHEMA
    name: str
    pixel_pitch_um: float
    press_pixels: int
    root: str
    presses: tuple[PlaceRecord, ...]
    left_out: tuple[str, ...] = ()
    unusable: tuple[str, ...] = ()
    links: tuple[LinkRecord, ...] = ()
    stretch_median: float | None = None
    stretch_spread: float | None = None
    span_um: float
    span_sigma_um: float
    covered_share: float
    period_um: float | None = None
    without_sigma: tuple[str, ...] = ()

    @property
    def used(self) -> tuple[LinkRecord, ...]:
        """The links that the mosaic holds to."""
        return tuple(link for link in self.links if link.used)

    @property
    def rejected(self) -> tuple[LinkRecord, ...]:
        """Links that looked right by themselves and do not fit the others."""
        return tuple(link for link in self.links if not link.used and link.residual_um is not None)


def encode_mosaic(record: MosaicRecord) -> bytes:
    """Return the bytes of `mosaic.json`."""
    return msgspec.json.format(msgspec.json.encode(record), indent=2)
