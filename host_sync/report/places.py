"""Draws what a recipe measures onto the relief of a report; names keep clear of one another."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle, Rectangle
from matplotlib.patheffects import withStroke

from host_sync.measurement.measurement import Measurement
from host_sync.measurement.recipe import DistanceTable, ProfileTable, StepTable
from host_sync.measurement.recipe import Rectangle as Region
from host_sync.text import printable

RED: Final = "#b03020"
LETTER_MM: Final = (0.0085, 0.026)
"""Width of a letter and height of a line as fractions of the field's longer side, about those of eight points."""

OFFSETS: Final = (0, -1, 1, -2, 2, -3, 3, -4, 4)
"""Places that are tried for a name, in lines."""

Box = tuple[float, float, float, float]


def draw_places(axes: Axes, measurement: Measurement) -> None:
    """Draw regions, lines, circles, painted masks and edges, each with its name."""
    recipe = measurement.recipe
    rows, columns = measurement.height.z_um.shape
    size_mm = max(rows, columns) * measurement.height.pitch_um / 1000.0
    regions: list[tuple[str, Region]] = [("", recipe.region_um)] if recipe.region_um else []
    regions += [(sphere.name, sphere.region_um) for sphere in recipe.radius]
    regions += [(volume.name, volume.region_um) for volume in recipe.volume]
    for angle in recipe.angle:
        regions += [(angle.name, angle.first_um), ("", angle.second_um)]
    names: list[tuple[str, float, float]] = []
    for name, region in regions:
        left, top, right, bottom = (value / 1000.0 for value in region)
        axes.add_patch(Rectangle((left, top), right - left, bottom - top, fill=False, color=RED, linewidth=1.2))
        names.append((name, left, bottom))
    for circle in recipe.circle:
        column, row = (place / 1000.0 for place in circle.centre_um)
        axes.add_patch(Circle((column, row), circle.radius_um / 1000.0, fill=False, color=RED, linewidth=1.2))
        names.append((circle.name, column + circle.radius_um / 1000.0, row))
    lines: list[ProfileTable | StepTable | DistanceTable] = [*recipe.profile, *recipe.step, *recipe.distance]
    for line in lines:
        ends = np.array([line.from_um, line.to_um]) / 1000.0
        axes.plot(*ends.T, color=RED, linewidth=1.2)
        names.append((line.name, float(ends[1, 0]), float(ends[1, 1])))
    for stroke in recipe.mask:
        places = np.array(stroke.points_um) / 1000.0
        axes.plot(*places.T, color="#ffffff", linewidth=3.0, alpha=0.8, solid_capstyle="round", marker=".")
    for step in measurement.steps:
        first, last = (np.array(place) / 1000.0 for place in (step.line.start_um, step.line.end_um))
        for edge_um in step.edges_um:
            column, row = first + (last - first) * (edge_um / step.line.length_um)
            axes.plot([column], [row], "x", color=RED, markersize=6)
    for words, column, row in placed(names, size_mm, columns * measurement.height.pitch_um / 1000.0):
        halo = [withStroke(linewidth=2.5, foreground="white")]
        axes.annotate(words.replace("$", r"\$"), (column, row), color=RED, fontsize=8, va="center", path_effects=halo)


def placed(
    names: list[tuple[str, float, float]], size_mm: float, width_mm: float
) -> Iterator[tuple[str, float, float]]:
    """Names and their places (mm), moved up or down until no two overlap, and left until they end inside the field.

    size_mm : the field's longer side; width_mm : its width
    """
    letter, line = (share * size_mm for share in LETTER_MM)
    taken: list[Box] = []
    for name, column, row in names:
        words = printable(name)
        if not words:
            continue
        width = letter * len(words)
        left = max(0.0, min(column, width_mm - width))
        boxes = [(left, row + line * (down - 0.5), left + width, row + line * (down + 0.5)) for down in OFFSETS]
        box = next((one for one in boxes if not any(_overlap(one, other) for other in taken)), boxes[0])
        taken.append(box)
        yield words, left, (box[1] + box[3]) / 2.0


def _overlap(one: Box, other: Box) -> bool:
    return one[0] < other[2] and other[0] < one[2] and one[1] < other[3] - 1e-9 and other[1] < one[3] - 1e-9
