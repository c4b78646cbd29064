"""A chart of numbers over results: values with their ±, mean, control limits, tolerance and capability."""

from __future__ import annotations

import io
from collections.abc import Sequence
from itertools import takewhile
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from device.io.atomic import write_output
from host_sync.errors import MeasurementError
from host_sync.measurement.measurement import Measurement
from host_sync.measurement.quantity import Quantity
from host_sync.measurement.trend import Trend, trends
from host_sync.text import printable

DPI: Final = 130
MOST_CHARTS: Final = 12
MOST_NAMES: Final = 40
"""Beyond so many results only those are named that lie beyond the control limits, and of them the first ones."""

MOST_NAMED: Final = 12
LONG_START: Final = 8
"""Letters that names have in common before they are left out of each."""

SUFFIXES: Final = (".png", ".pdf", ".svg")
COLOURS: Final = {"pass": "#1d5d33", "fail": "#8c2f1b", "undecided": "#7a4a00", "": "#0b5f69"}
SIGNS: Final = {"pass": "o", "fail": "X", "undecided": "s", "": "o"}


def check_trend(path: Path) -> None:
    """Refuse a chart's file that is no picture.

    Raises
    ------
    MeasurementError
        Names the endings that are accepted.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise MeasurementError(f"{path}: a chart is a picture: name it with {', '.join(SUFFIXES)}")


def write_trend(path: Path, measurements: Sequence[Measurement]) -> None:
    """Write the chart of the numbers that have a tolerance, or of the first ones.

    Raises
    ------
    MeasurementError
        Fewer than two results have a number, or the file is no picture.
    OutputError
        The file cannot be written.
    """
    check_trend(path)
    chosen = chosen_trends(measurements)
    names = [printable(one.record.name) for one in measurements]
    figure = Figure(figsize=(8.0, 2.6 * len(chosen) + 0.6), layout="constrained")
    panels = np.ravel(figure.subplots(len(chosen), 1, squeeze=False))
    for axes, (example, row, trend) in zip(panels, chosen, strict=True):
        draw_chart(axes, example, row, trend, names)
        words = f"{printable(example.subject)}: {trend.text(example.unit)}"
        axes.set_title(words.replace("; ", "\n"), fontsize=8, loc="left")
    picture = io.BytesIO()
    figure.savefig(picture, dpi=DPI, format=path.suffix.lower()[1:])
    write_output(path, picture.getvalue())


def chosen_trends(measurements: Sequence[Measurement]) -> list[tuple[Quantity, list[Quantity | None], Trend]]:
    """Return the first trends of numbers that have a tolerance, or of all numbers where none has.

    Raises
    ------
    MeasurementError
        Fewer than two results have a number.
    """
    found = trends(measurements).values()
    chosen = [one for one in found if one[0].limits is not None] or list(found)
    if not chosen:
        raise MeasurementError("a trend needs two results or more with the same number: name more results")
    return chosen[:MOST_CHARTS]


def draw_chart(
    axes: Axes, example: Quantity, row: Sequence[Quantity | None], trend: Trend, names: Sequence[str]
) -> None:
    """Draw the control chart of a number: values with their ±, mean, control limits and tolerance.

    row : the number of each result, None where it has none; results beyond the control limits are named
    """
    for verdict, colour in COLOURS.items():
        points = [
            (at, one)
            for at, one in enumerate(row)
            if one is not None and one.value is not None and (one.limits.verdict if one.limits else "") == verdict
        ]
        if points:
            axes.errorbar(
                [at for at, _ in points],
                [one.value or 0.0 for _, one in points],
                yerr=[one.uncertainty or 0.0 for _, one in points],
                fmt=SIGNS[verdict],
                color=colour,
                capsize=3,
                linestyle="none",
                label=verdict or None,
            )
    axes.axhline(trend.mean, color="#1b2423", linewidth=1.0)
    for bound in (trend.control_low, trend.control_high):
        axes.axhline(bound, color="#55625f", linewidth=0.9, linestyle="--")
    limits = example.limits
    for end in (limits.low, limits.high) if limits else ():
        if end is not None:
            axes.axhline(end, color=COLOURS["fail"], linewidth=1.1)
    unit = f", {example.unit}" if example.unit else ""
    axes.set_ylabel(f"{printable(example.name)}{unit}")
    shown = len(names) <= MOST_NAMES
    if shown:
        start, ends = without_common_start(names)
        axes.set_xticks(range(len(names)), ends, rotation=60, ha="right", fontsize=7)
        if start:
            axes.set_xlabel(f"{start}…", fontsize=7)
    else:
        axes.set_xlabel("result, counted from 0", fontsize=7)
    for at in () if shown else trend.beyond[:MOST_NAMED]:
        one = row[at]
        if one is not None and one.value is not None:
            axes.annotate(names[at], (at, one.value), (4.0, 4.0), textcoords="offset points", fontsize=6)
    axes.grid(visible=True, axis="y", alpha=0.3)
    if limits:
        axes.legend(fontsize=7, loc="best")


def without_common_start(names: Sequence[str]) -> tuple[str, list[str]]:
    """Return the common beginning of all names, up to a sign between their parts, and the rest of each.

    Ids would leave a chart no room. Names whose common beginning is shorter than `LONG_START` stay as they are.
    """
    common = "".join(letters[0] for letters in takewhile(lambda some: len(set(some)) == 1, zip(*names, strict=False)))
    start = common[: 1 + max(common.rfind(sign) for sign in "-_. ")]
    if len(start) < LONG_START or start in names:
        return "", list(names)
    return start, [name.removeprefix(start) for name in names]
