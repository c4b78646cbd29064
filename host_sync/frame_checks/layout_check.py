"""Refuses a frame whose sides or channels are exchanged against the calibration's.

Most of a frame's light is that of lights over skin, whatever is pressed. A frame whose channels or sides are exchanged
is explained far better by the reference with the same exchange.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from device.imaging.flat_field import DARK_FLOOR, NormalizedImage
from device.surface import Float32Array
from host_sync.frame_checks.light_levels import cell_logs
from host_sync.results.record import FrameCheck, not_checked

CLEARLY_BETTER: Final = 0.6
"""An exchange counts when it leaves less than this fraction of what the reference as it is leaves unexplained."""

MIN_UNEXPLAINED: Final = 0.03
"""Deviation of log light below which the reference as it is explains the frame well enough."""

EQUALLY_GOOD: Final = 1.3
"""Exchanges that leave up to so many times as much as the best one are named beside it."""

_ORDERS: Final = tuple(order for order in permutations(range(3)) if order != (0, 1, 2))


@dataclass(frozen=True, slots=True)
class Exchange:
    """An exchange of channels or sides in a frame, in words, and the residual with and without it (log light).

    turned : the sides, or the channels when False
    """

    name: str
    left: float
    as_given: float
    turned: bool


def find_exchanges(cells: Float32Array, rest: Float32Array, *, turns: bool) -> list[Exchange]:
    """Return the exchanges that explain a frame clearly better than the reference as it is, best first.

    cells : float32 array of shape (h, w, 3), log intensity of the frame
    rest : the same shape, log light of the reference
    turns : whether turned and mirrored frames come into question
    """
    light = cells + rest
    as_given = median_deviation(cells)
    if as_given < MIN_UNEXPLAINED:
        return []
    tried = [Exchange(_order_name(order), median_deviation(light[..., order] - rest), as_given, False)
             for order in _ORDERS]  # fmt: skip
    if turns:
        tried += [
            Exchange(turn.name, median_deviation(turn.of(light) - rest), as_given, True)
            for turn in turns_of(rest.shape)
        ]
    best = min(tried, key=lambda exchange: exchange.left)
    if best.left > CLEARLY_BETTER * as_given:
        return []
    near = [exchange for exchange in tried if exchange.left <= EQUALLY_GOOD * best.left]
    return sorted(near, key=lambda exchange: exchange.left)


def hidden_turns(rest: Float32Array) -> list[Turn]:
    """Return the turns that the light of a reference, float32 array (h, w, 3), cannot show: it looks the same."""
    return [turn for turn in turns_of(rest.shape) if median_deviation(turn.of(rest) - rest) < MIN_UNEXPLAINED]


def _order_name(order: tuple[int, ...]) -> str:
    """Return the order that a frame's channels have when taking them in `order` restores R, G, B."""
    names = [""] * 3
    for place, channel in zip(order, "RGB", strict=True):
        names[place] = channel
    return f"the channels are in the order {', '.join(names)}"


NAME = "light layout"


@dataclass(frozen=True, slots=True, eq=False)
class LayoutModel:
    """The light of the reference over the field.

    rest : float32 array of shape (h, w, 3), its logarithm
    hidden : turns that leave it as it is, in words
    """

    rest: Float32Array
    hidden: tuple[str, ...]

    @classmethod
    def of(cls, flat_field: Float32Array) -> LayoutModel:
        """Return the layout of a reference, float32 array of shape (H, W, 3)."""
        everywhere = np.ones(flat_field.shape[:2], np.bool_)
        lit = np.maximum(flat_field, np.float32(DARK_FLOOR))
        rest = cell_logs(NormalizedImage(np.asarray(lit, np.float32), everywhere, ~everywhere))
        return cls(rest, tuple(turn.name for turn in hidden_turns(rest)))

    def check(self, cells: Float32Array, *, pattern_seen: bool) -> FrameCheck:
        """Return the check of a frame's log intensity in cells.

        pattern_seen : the skin's pattern proves that the frame is not turned
        """
        found = find_exchanges(cells, self.rest, turns=not pattern_seen)
        if not found:
            if self.hidden and not pattern_seen:
                return not_checked(NAME, f"the lights look the same in a frame that is {', or '.join(self.hidden)}")
            return FrameCheck(NAME, "passed")
        turned = [exchange for exchange in found if exchange.turned]
        others = [exchange for exchange in found if not exchange.turned]
        words = []
        if turned:
            words.append("its light is distributed over the field as if it were " + " or ".join(e.name for e in turned))
        if others:
            words.append(others[0].name + " where the reference has R, G, B")
        ratio = found[0].left / found[0].as_given
        detail = (
            f"{', or '.join(words)}: that leaves {ratio:.0%} of what it leaves unexplained as it is "
            f"(below {CLEARLY_BETTER:.0%} counts)"
        )
        return FrameCheck(NAME, "refused", ratio, CLEARLY_BETTER, "of what is unexplained", detail)


# The ways in which a whole frame can be turned or mirrored.


@dataclass(frozen=True, slots=True)
class Turn:
    """One way: rows and columns exchanged or not, then each of them run through backwards or not."""

    name: str
    transposed: bool
    rows_backwards: bool
    columns_backwards: bool

    def of(self, field: NDArray[Any]) -> NDArray[Any]:
        """Return a field of shape (H, W, ...) turned this way; every one but the quarter turns is its own inverse."""
        turned = field.swapaxes(0, 1) if self.transposed else field
        return turned[:: -1 if self.rows_backwards else 1, :: -1 if self.columns_backwards else 1]


HALF_TURNS: Final = (
    Turn("turned by 180 degrees", False, True, True),
    Turn("mirrored left to right", False, False, True),
    Turn("mirrored top to bottom", False, True, False),
)
"""Every turn that keeps rows rows."""

_QUARTERS = (
    Turn("turned by 90 degrees clockwise", True, True, False),
    Turn("turned by 90 degrees anticlockwise", True, False, True),
    Turn("mirrored about its diagonal", True, False, False),
    Turn("mirrored about its other diagonal", True, True, True),
)
"""Each named after what was done to the frame; it undoes that."""


def turns_of(shape: tuple[int, ...]) -> tuple[Turn, ...]:
    """Return every way that leaves a field of shape (H, W, ...) its shape, the untouched one excepted."""
    return HALF_TURNS + (_QUARTERS if shape[0] == shape[1] else ())


def median_deviation(field: NDArray[np.float32]) -> float:
    """Return the mean over channels of the median absolute deviation from one median, field of shape (H, W, 3)."""
    return float(np.median(np.abs(field - np.median(field)), axis=(0, 1)).mean())
