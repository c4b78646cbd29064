"""Refuses a frame whose sides or channels are exchanged against the calibration's."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from device.imaging.flat_field import DARK_FLOOR, NormalizedImage
from device.surface.fields import Float32Array
from host_sync.frame_checks.light_layout import CLEARLY_BETTER, find_exchanges, hidden_turns
from host_sync.frame_checks.light_levels import cell_logs
from host_sync.results.frame_check import FrameCheck, not_checked

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
        """The layout of a reference, float32 array of shape (H, W, 3)."""
        everywhere = np.ones(flat_field.shape[:2], np.bool_)
        lit = np.maximum(flat_field, np.float32(DARK_FLOOR))
        rest = cell_logs(NormalizedImage(np.asarray(lit, np.float32), everywhere, ~everywhere))
        return cls(rest, tuple(turn.name for turn in hidden_turns(rest)))

    def check(self, cells: Float32Array, *, pattern_seen: bool) -> FrameCheck:
        """The check of a frame's log intensity in cells.

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
            words.append("its light lies over the field as if it were " + " or ".join(e.name for e in turned))
        if others:
            words.append(others[0].name + " where the reference has R, G, B")
        ratio = found[0].left / found[0].as_given
        told = (
            f"{', or '.join(words)}: that leaves {ratio:.0%} of what it leaves unexplained as it is "
            f"(below {CLEARLY_BETTER:.0%} counts)"
        )
        return FrameCheck(NAME, "refused", ratio, CLEARLY_BETTER, "of what is unexplained", told)
