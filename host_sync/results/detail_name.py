"""Names of the two kinds of detail of a height map, for commands: where they are made, numerics are loaded."""

from __future__ import annotations

from typing import Literal

DetailName = Literal["raw", "shrunk"]
"""raw: every pixel's own slope, noise included. shrunk: from frames whose pixel noise was shrunk."""


def other_detail(detail: DetailName) -> DetailName:
    """The other kind."""
    return "shrunk" if detail == "raw" else "raw"
