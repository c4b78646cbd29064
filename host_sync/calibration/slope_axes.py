"""Axes in slope space and the words under a figure, common to the figures of the paper's method."""

from __future__ import annotations

from textwrap import fill
from typing import Final

from matplotlib.axes import Axes
from matplotlib.figure import Figure

P_LABEL: Final = "p = dz/dcolumn, µm/µm"
Q_LABEL: Final = "q = dz/drow, µm/µm"

_CHARACTERS_PER_INCH: Final = 15.0


def frame_slopes(axes: Axes, reach: float) -> None:
    """Slopes from -reach to reach in both directions, as rows and columns lie in a frame: q grows downwards."""
    axes.set_aspect("equal")
    axes.set_xlim(-reach, reach)
    axes.set_ylim(reach, -reach)
    axes.tick_params(labelsize=8)


def caption(figure: Figure, words: str) -> None:
    """Write a caption under the figure, broken to its width."""
    width = int(_CHARACTERS_PER_INCH * figure.get_size_inches()[0])
    figure.supxlabel(fill(words, width), fontsize=9, x=0.01, ha="left", multialignment="left")
