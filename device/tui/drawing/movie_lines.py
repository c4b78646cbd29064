"""The press of a movie over time: contact and depth as bars."""

from __future__ import annotations

from typing import Final

import numpy as np

from device.bundles.movie import MovieRecord
from device.surface.fields import Float64Array
from device.tui.drawing.cells import ColourDepth
from device.tui.drawing.profile import EIGHTHS, HALVES

BARS: Final = 7
"""Bars of either, so that both fit in a line beside the history on a screen of 80 columns."""


def movie_text(movie: MovieRecord, depth: ColourDepth) -> str:
    """Contact and depth over the press with the largest value of each, in a line; a frame without one has no bar."""
    time_ms = np.array([frame.at_ms for frame in movie.frames])
    contact = np.array([frame.contact_fraction for frame in movie.frames], np.float64)
    depth_um = np.array([frame.depth_um for frame in movie.frames], np.float64)
    blocks = EIGHTHS if depth == "full" else HALVES
    parts = [
        f"{name} {_bars(time_ms, values, blocks)} {np.nanmax(values):.0f} {unit}"
        for name, values, unit in (("contact", 100.0 * contact, "%"), ("depth", depth_um, "µm"))
        if np.isfinite(values).any()
    ]
    text = ", ".join(parts)
    return f"{text[:1].upper()}{text[1:]}"


def _bars(time_ms: Float64Array, values: Float64Array, blocks: str) -> str:
    """Bars from zero to the largest value, at even times; each that of the frame nearest in time."""
    count = min(BARS, values.size)
    at_ms = np.linspace(time_ms[0], time_ms[-1], count)
    nearest = np.abs(time_ms[None, :] - at_ms[:, None]).argmin(axis=1)
    share = values[nearest] / max(float(np.nanmax(values)), 1e-9)
    level = np.clip(np.ceil(np.nan_to_num(share) * (len(blocks) - 1)), 0, len(blocks) - 1).astype(int)
    return "".join(blocks[one] for one in level)
