"""A scan that is to be taken again: what the press for it must know, even if the scan is gone by then."""

from __future__ import annotations

from dataclasses import dataclass

from device.bundles.scan import Annotations, VerdictLevel


@dataclass(frozen=True, slots=True)
class Retake:
    """The scan that a press is to replace, as it was when the operator asked for that."""

    scan_id: str
    counter: int
    level: VerdictLevel
    annotations: Annotations

    def is_replaced_by(self, level: VerdictLevel) -> bool:
        """Return whether a press with this verdict replaces it: not one that is worse, or to be taken again itself."""
        return level != "retake" and not (level == "doubtful" and self.level == "good")
