"""All that a mosaic is made from, but the heights."""

from __future__ import annotations

from dataclasses import dataclass

from host_sync.mosaic.adjustment import Adjusted
from host_sync.mosaic.levelling import Levels, Meeting
from host_sync.mosaic.links import Link
from host_sync.mosaic.motion import Motion


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """Links, places and levels.

    refused : links that were refused by themselves
    links : the others
    adjusted : of `links`
    places : of the presses that have one, by number, in a mosaic that is not turned in the mean
    meetings : of the links in use, by their number among `links`; presses are numbered as in `levels`
    levels : planes of the presses in `places`, in their order
    without_sigma : presses that state no uncertainty of their heights, by number
    period_px : distance after which the relief repeats itself, where places may be off by it; else None
    """

    refused: list[Link]
    links: list[Link]
    adjusted: Adjusted
    places: dict[int, Motion]
    meetings: dict[int, Meeting]
    levels: Levels
    without_sigma: frozenset[int] = frozenset()
    period_px: float | None = None
