"""Types of the arguments of `host_sync.api`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Image = str | Path | tuple[str | Path, ...] | NDArray[Any]
    """An RGB image file; a grey one a light (three in R, G, B order); or an array of shape (H, W, N): uint8, uint16, or
    fractions of full scale."""

Encoding = Literal["linear", "srgb"]
Method = Literal["direct", "paper"]
Detail = Literal["shrunk", "raw"]


@dataclass(frozen=True, slots=True, eq=False)
class Press:
    """A calibration press: an image in which balls of one radius touch the skin.

    balls : (column, row, radius of the trusted contact) of each, pixels; None to have them found
    grid_pitch_mm : distance of neighbouring balls when they form a square grid

    >>> Press("ball-0.png", ball_radius_mm=0.96, balls=[(76.8, 80.6, 28.8)]).ball_radius_mm
    0.96
    """

    image: Image
    ball_radius_mm: float
    balls: Sequence[tuple[float, float, float]] | None = None
    grid_pitch_mm: float | None = None
