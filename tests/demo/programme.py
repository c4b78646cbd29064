"""What the demo shows, and what its processes hand back; loads nothing that computes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

BALL_RADIUS_MM: Final = 3.0
VERDICT: Final = "verdict: "
"""A step that begins with it stays on the screen."""


@dataclass(frozen=True)
class Act:
    """One instrument of the demo, the distance of its lights, and what is pressed on it."""

    board: str
    title: str
    objects: tuple[str, ...]


ACTS: Final = (
    Act("twin", "25 mm", ("sphere", "coin", "texture")),
    Act("twin-distant", "250 mm", ("sphere",)),
)


@dataclass(frozen=True, eq=False)
class Shown:
    """What is shown of one scan.

    figures : its row of the table of errors
    row_rgb : its row of the summary picture, uint8 array of shape (H, W, 3); W is the same for all
    """

    title: str
    figures: tuple[str, ...]
    row_rgb: NDArray[np.uint8]
