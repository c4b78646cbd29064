"""The report of a population: control charts of its numbers, mean and Cpk with their ±, and outliers as thumbnails."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import takewhile
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from device.io.atomic import write_output
from device.surface import HeightMap
from host_sync.errors import HostError, MeasurementError
from host_sync.measurement.measurement import Measurement, operations
from host_sync.measurement.quantity import Quantity, plain
from host_sync.measurement.trend import MIN_COUNT, Trend, trends, with_uncertainty
from host_sync.render.relief_sheet import CELL_PX, contact_sheet
from host_sync.render.shading import height_range_um
from host_sync.render.still import Still, render, resize_to_width
from host_sync.report.composing import hashed_file, origin_of, place_of, signature, worst
from host_sync.report.pictures import picture_of
from host_sync.report.writing import Picture, Report, Table, Template
from host_sync.results.files import RECORD_FILE
from host_sync.results.reader import read_result
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


MOST_THUMBNAILS: Final = 12
ACROSS: Final = 3
"""Thumbnails in a row."""

_HEAD: Final = ("number", "mean", "range, s", "control limits, beyond", "Cp, Cpk, Ppk")

_Charted = tuple[Quantity, list[Quantity | None], Trend]


@dataclass(frozen=True, slots=True)
class Outlier:
    """A result that differs from the others.

    reasons : each a number, and what it lies beyond or fails
    distance : how far its worst number lies from the mean, over the distance of its control limits
    """

    at: int
    reasons: tuple[tuple[str, str], ...]
    distance: float


def compose_population(
    measurements: Sequence[Measurement], template: Template | None = None, logo: Picture | None = None
) -> Report:
    """Return the report of two results or more, in their order; maps are read for outliers only.

    Raises
    ------
    MeasurementError
        Fewer than two results share a number, or a result's record cannot be read.
    """
    if len(measurements) < MIN_COUNT:
        raise MeasurementError("a population is two results or more: name more, or leave out --population")
    template = template or Template()
    charted = chosen_trends(measurements)
    found = outliers(measurements, charted)
    names = [printable(one.record.name) for one in measurements]
    thumbnails, unread = _thumbnails(measurements, found)
    pictures = [_chart(*one, names) for one in charted] if "pictures" in template.parts else []
    notes = list(dict.fromkeys(note for one in measurements for note in one.notes))
    hashes = Table("Provenance", ("file", "bytes", "SHA-256"), tuple(_hashes(measurements)))
    report = Report(
        title=f"{len(measurements)} results",
        operations=operations(measurements[0].recipe),
        facts=tuple((label, value) for label, value in _facts(measurements, found, template) if value),
        warnings=tuple(_warnings(measurements, found)),
        pictures=(*pictures, *thumbnails) if "pictures" in template.parts else (),
        tables=(_numbers(charted), *_outlier_tables(measurements, found)),
        notes=(*notes, *unread) if "notes" in template.parts else (),
        appendix=(hashes,) if "provenance" in template.parts else (),
        head=tuple(line for line in (template.organisation, template.address) if line),
        logo=logo,
        verdict=worst(measurements),
        footer=template.footer,
    )
    return replace(report, signature=signature(report, hashes))


def outliers(measurements: Sequence[Measurement], charted: Sequence[_Charted]) -> list[Outlier]:
    """Return the results that stand out, the farthest first.

    Such a result has a number beyond its control limits or its tolerance, or lacks one that the recipe asks for.
    """
    trend_by_number = {(example.subject, example.name): trend for example, _, trend in charted}
    found = []
    for at, measurement in enumerate(measurements):
        reasons = [(name, "not found on this result") for name in measurement.failed]
        distance = 0.0
        for one in measurement.quantities:
            words = []
            trend = trend_by_number.get((one.subject, one.name))
            if trend is not None and one.value is not None and at in trend.beyond:
                half = max((trend.control_high - trend.control_low) / 2.0, 1e-12)
                distance = max(distance, abs(one.value - trend.mean) / half)
                words.append(f"beyond the control limits {plain(trend.control_low)} to {plain(trend.control_high)}")
            if one.limits is not None and one.limits.verdict == "fail":
                words.append(one.limits.words)
            if words:
                reasons.append((f"{one.subject} {one.name} {one.number}", "; ".join(words)))
        if reasons:
            found.append(Outlier(at, tuple(reasons), distance))
    return sorted(found, key=lambda one: (-one.distance, one.at))


def _facts(
    measurements: Sequence[Measurement], found: Sequence[Outlier], template: Template
) -> Iterator[tuple[str, str]]:
    yield "recipe", measurements[0].recipe.name
    yield "procedure", template.procedure
    yield "instrument", template.instrument
    yield "operator", template.operator
    yield "results", f"{len(measurements)}, {measurements[0].record.name} to {measurements[-1].record.name}"
    yield "outliers", f"{len(found)} of {len(measurements)}"
    for label, values in (
        ("gels", {one.record.gel_id for one in measurements}),
        ("calibrations", {one.record.calibration_id for one in measurements}),
    ):
        known = sorted(value for value in values if value)
        yield label, ", ".join(known[:8]) + (f" and {len(known) - 8} more" if len(known) > 8 else "")


def _warnings(measurements: Sequence[Measurement], found: Sequence[Outlier]) -> Iterator[str]:
    """Yield each doubt once, with the number of results that have it."""
    beyond = sum(one.distance > 0.0 for one in found)
    if 2 * beyond > len(measurements):
        count = len(measurements)
        yield f"not one population: {beyond} of {count} results lie beyond control limits; name parts of one kind"
    kinds = [dict.fromkeys(doubt.kind for doubt in one.doubts) for one in measurements]
    for kind in dict.fromkeys(kind for one in kinds for kind in one):
        yield f"{kind} ({sum(kind in one for one in kinds)} of {len(measurements)} results)"


def _numbers(charted: Sequence[_Charted]) -> Table:
    rows = []
    for example, _, trend in charted:
        unit = f" {example.unit}" if example.unit else ""
        limits = "" if example.limits is None else f", tolerance {example.limits.words.partition(': ')[2]}{unit}"
        capability = "no tolerance" if example.limits is None else "not known"
        if trend.cpk is not None and trend.ppk is not None:
            cp = "" if trend.cp is None else f"{trend.cp:.2f}, "
            capability = f"{cp}{with_uncertainty(trend.cpk, trend.cpk_uncertainty)}, {trend.ppk:.2f}"
        control = f"{plain(trend.control_low)} to {plain(trend.control_high)}{unit}"
        rows.append(
            (
                f"{example.subject} {example.name}{limits}",
                with_uncertainty(trend.mean, trend.mean_uncertainty, unit),
                f"{plain(trend.range)}{unit}, {plain(trend.deviation)}{unit}",
                f"{control}, {len(trend.beyond)} of {trend.count}",
                capability,
            )
        )
    factors = sorted({trend.coverage_factor for _, _, trend in charted})
    doubts = dict.fromkeys(words for _, _, trend in charted for words in trend.doubts)
    remarks = (
        f"± at k = {', '.join(map(str, factors))}; control limits: mean ± 2.66 mean moving ranges (ISO 7870-2, "
        "individuals); Cp and Cpk from the mean moving range, Ppk from the standard deviation s of all",
        *(f"doubt: {words}" for words in doubts),
    )
    return Table("Numbers of all results", _HEAD, tuple(rows), remarks)


def _outlier_tables(measurements: Sequence[Measurement], found: Sequence[Outlier]) -> Iterator[Table]:
    if found:
        rows = tuple(
            (measurements[one.at].record.name, "; ".join(": ".join(reason) for reason in one.reasons)) for one in found
        )
        yield Table("Outliers, the farthest first", ("result", "why"), rows, ())


def _chart(example: Quantity, row: list[Quantity | None], trend: Trend, names: list[str]) -> Picture:
    figure = Figure(figsize=(7.0, 2.9), layout="constrained")
    draw_chart(figure.add_subplot(), example, row, trend, names)
    return picture_of(
        figure,
        f"{example.subject} {example.name}: values with ±, mean, control limits (dashed): {trend.text(example.unit)}",
    )


def _thumbnails(measurements: Sequence[Measurement], found: Sequence[Outlier]) -> tuple[list[Picture], list[str]]:
    """Return a sheet of the farthest outliers with one range of colours, and a note for each that cannot be drawn."""
    heights: list[tuple[str, str, HeightMap]] = []
    notes = []
    for one in found[:MOST_THUMBNAILS]:
        measurement = measurements[one.at]
        try:
            height = resize_to_width(read_result(measurement.folder, samples=False).height, CELL_PX)
        except HostError as error:
            notes.append(f"{measurement.record.name}: no thumbnail: {error}")
            continue
        heights.append((measurement.record.name, one.reasons[0][0], height))
    if not heights:
        return [], notes
    ends = [height_range_um(height) for _, _, height in heights]
    range_um = min(low for low, _ in ends), max(high for _, high in ends)
    still = Still(columns=CELL_PX, range_um=range_um)
    cells = [(name, why, render(height, still)) for name, why, height in heights]
    sheet = contact_sheet(cells, ACROSS, range_um)
    _, data = cv2.imencode(".png", sheet[..., ::-1])
    more = f", the farthest {len(heights)} of {len(found)}" if len(found) > len(heights) else ""
    caption = f"Outliers{more}, in one range of colours"
    return [Picture(caption, data.tobytes(), (sheet.shape[1], sheet.shape[0]))], notes


def _hashes(measurements: Sequence[Measurement]) -> Iterator[tuple[str, str, str]]:
    """Yield the record of each result, which names its scan and calibration."""
    for one in measurements:
        place = place_of(one.folder, origin_of(one.folder, one.record))
        if one.folder.is_dir():
            yield hashed_file(f"{place}/{RECORD_FILE}", one.folder / RECORD_FILE)
        else:
            yield hashed_file(str(place), one.folder)
