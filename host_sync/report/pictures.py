"""The report's pictures, each a PNG in memory."""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle
from matplotlib.patheffects import withStroke

from device.bundles.scan import MovieRecord, ScanBundle
from device.imaging.flat_field import demosaic
from device.surface import Float32Array, HeightMap
from host_sync.iso25178.areal_parameters import MaterialRatioCurve, core_line, core_parameters
from host_sync.measurement.measurement import MeasuredProfile, MeasuredSpectrum, MeasuredStep, Measurement
from host_sync.measurement.recipe import DistanceTable, ProfileTable, StepTable
from host_sync.measurement.recipe import Rectangle as Region
from host_sync.render.picture_file import draw_relief
from host_sync.render.relief_sheet import MAX_COLUMNS
from host_sync.render.shading import reduced
from host_sync.report.writing import Picture
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
    """Yield names and their places (mm) in the field, without overlap where there is room.

    A name is moved up or down until it overlaps no other, and left until it ends inside the field.

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


DPI: Final = 130
MIN_CURVE: Final = 10
"""Fewest valid pixels with a material ratio curve."""

FRAME_PX: Final = 900
GAMMA: Final = 1.0 / 2.2
BRIGHT_PERCENTILE: Final = 99.5
_RED: Final = "#b03020"
_BLUE: Final = "#24527a"


def pictures_of(measurement: Measurement, scan: ScanBundle | None, overview: Path | None = None) -> Iterator[Picture]:
    """Yield every picture of a measurement, the whole relief first."""
    yield relief_picture(measurement)
    if scan is not None:
        yield frame_picture(scan)
        if scan.record.movie is not None:
            yield movie_picture(scan.record.movie, measurement.height)
    if measurement.sigma_um is not None:
        yield sigma_picture(measurement.sigma_um, measurement.height.pitch_um)
    yield surface_picture(measurement)
    for one in measurement.profiles:
        yield profile_picture(one, measurement.recipe.coverage_factor)
    for step in measurement.steps:
        yield step_picture(step)
    yield ratio_picture(measurement)
    if measurement.spectrum is not None:
        yield spectrum_picture(measurement.spectrum, measurement.recipe.coverage_factor)
    if overview is not None:
        yield from overview_picture(overview)


def overview_picture(path: Path) -> Iterator[Picture]:
    """Yield the calibration's overview; nothing where the file is no picture."""
    png = path.read_bytes()
    image = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR) if png else None
    if image is not None:
        caption = "The calibration: its presses, used or not and why, error by place, and the reference read as a scan"
        yield Picture(caption, png, (image.shape[1], image.shape[0]), is_sheet=True)


def relief_picture(measurement: Measurement) -> Picture:
    """Return the whole height map, with the measured region and lines."""
    figure, axes = _figure(7.0, 5.2, grid=False)
    draw_relief(axes, measurement.height, "")
    draw_places(axes, measurement)
    words = "Height map with the places that were measured; white is masked"
    return picture_of(figure, words + _doubtful([doubt.sentence for doubt in measurement.doubts]))


def sigma_picture(sigma_um: Float32Array, pitch_um: float) -> Picture:
    """Return the standard uncertainty of the height, pixel by pixel."""
    small = reduced(HeightMap(sigma_um, pitch_um), MAX_COLUMNS)
    rows, columns = small.z_um.shape
    mm = small.pitch_um / 1000.0
    figure, axes = _figure(7.0, 4.6, grid=False)
    shown = axes.imshow(small.z_um, extent=(0.0, columns * mm, rows * mm, 0.0), cmap="cividis", vmin=0.0)
    axes.set_xlabel("column, mm")
    axes.set_ylabel("row, mm")
    figure.colorbar(shown, cax=axes.inset_axes((1.02, 0.0, 0.03, 1.0)), label="standard uncertainty, µm")
    return picture_of(figure, "Standard uncertainty of the height above untouched skin (k = 1)")


def surface_picture(measurement: Measurement) -> Picture:
    """Return the scale-limited surface."""
    figure, axes = _figure(7.0, 4.6, grid=False)
    draw_relief(axes, measurement.surface, "")
    return picture_of(figure, "Scale-limited surface of the region, from which the areal parameters are taken")


def frame_picture(scan: ScanBundle) -> Picture:
    """Return the camera's frame, brightened for display."""
    rgb = demosaic(scan.raw_frame()).rgb
    factor = max(1, int(np.ceil(rgb.shape[1] / FRAME_PX)))
    small = cv2.resize(rgb, (rgb.shape[1] // factor, rgb.shape[0] // factor), interpolation=cv2.INTER_AREA)
    white = max(float(np.percentile(small, BRIGHT_PERCENTILE)), 1e-6)
    shown = (255.0 * np.clip(small / white, 0.0, 1.0) ** GAMMA).astype(np.uint8)
    _, data = cv2.imencode(".png", shown[..., ::-1])
    return Picture(
        "Frame: one exposure in the light of all three lights", data.tobytes(), (shown.shape[1], shown.shape[0])
    )


def movie_picture(movie: MovieRecord, height: HeightMap) -> Picture:
    """Return contact and depth over the time of a press.

    height : of the whole field
    """
    rows, columns = height.z_um.shape
    field_mm2 = rows * columns * (height.pitch_um / 1000.0) ** 2
    time_s = np.array([frame.at_ms for frame in movie.frames]) / 1000.0
    contact = np.array([np.nan if f.contact_fraction is None else f.contact_fraction for f in movie.frames], float)
    depth_um = np.array([np.nan if f.depth_um is None else f.depth_um for f in movie.frames], float)
    figure = Figure(figsize=(7.0, 3.2), layout="constrained")
    panels = np.ravel(figure.subplots(2, 1, sharex=True))
    for axes, values, words in zip(panels, (field_mm2 * contact, depth_um), ("contact, mm²", "depth, µm"), strict=True):
        axes.plot(time_s, values, color=_BLUE, linewidth=1.1, marker=".", markersize=3.0)
        axes.axvline(time_s[movie.best], color=_RED, linewidth=0.8, linestyle="--")
        axes.set_ylabel(words)
        axes.set_ylim(bottom=0.0)
        axes.grid(visible=True, linewidth=0.3, alpha=0.5)
    panels[-1].set_xlabel("time, s")
    unread = int(np.isnan(depth_um).sum())
    words = f"The press over time, {len(movie.frames)} frames; the scan was taken at the dashed line"
    return picture_of(figure, words + (f"; {unread} frames without a depth" if unread else ""))


def profile_picture(one: MeasuredProfile, factor: int) -> Picture:
    """Return a profile with its uncertainty as a band."""
    figure, axes = _figure(7.0, 2.6)
    along_mm = one.profile.along_um / 1000.0
    if one.sigma_um is not None:
        low, high = (one.profile.z_um + side * factor * one.sigma_um for side in (-1.0, 1.0))
        axes.fill_between(along_mm, low, high, color=_BLUE, alpha=0.25, linewidth=0.0)
    axes.plot(along_mm, one.profile.z_um, color=_BLUE, linewidth=0.9)
    axes.set_xlabel("along the line, mm")
    axes.set_ylabel("height, µm")
    band = f"; band: ± at k = {factor}" if one.sigma_um is not None else ""
    return picture_of(figure, f"Profile {one.name}, levelled and filtered along itself{band}{_doubtful(one.doubts)}")


def step_picture(one: MeasuredStep) -> Picture:
    """Return a step's profile with its edges, and the lines whose distance is its height."""
    figure, axes = _figure(7.0, 2.6)
    along_mm = one.profile.along_um / 1000.0
    axes.plot(along_mm, one.profile.z_um, color=_BLUE, linewidth=0.9)
    for line_um in (one.base_um, one.top_um):
        axes.plot(along_mm, line_um, color=_RED, linewidth=0.6, linestyle=":")
    used_um = np.where(one.used, one.profile.z_um, np.nan)
    axes.plot(along_mm, used_um, color=_RED, linewidth=1.8, alpha=0.6)
    for edge_um in one.edges_um:
        axes.axvline(edge_um / 1000.0, color=_RED, linewidth=0.8, linestyle="--")
    axes.set_xlabel("along the line, mm")
    axes.set_ylabel("height, µm")
    places = ", ".join(f"{edge_um / 1000.0:.3f}" for edge_um in one.edges_um)
    words = f"{one.name}: edges at {places} mm (dashed); thick red is what both lines are fitted to"
    return picture_of(figure, words + _doubtful(one.doubts))


def _doubtful(doubts: Sequence[str]) -> str:
    return f". Doubt: {'; '.join(doubts)}" if doubts else ""


def ratio_picture(measurement: Measurement) -> Picture:
    """Return the areal material ratio curve with the construction of Sk."""
    curve = MaterialRatioCurve.of(measurement.surface.z_um)
    share = np.linspace(0.0, 1.0, 400)
    figure, axes = _figure(7.0, 2.6)
    axes.plot(100.0 * share, [curve.height_um(float(one)) for one in share], color=_BLUE, linewidth=1.1)
    words = "Material ratio curve of the scale-limited surface"
    if curve.falling_um.size >= MIN_CURVE:
        top, bottom = core_line(curve.falling_um)
        core = core_parameters(curve)
        axes.plot([0.0, 100.0], [top, bottom], color=_RED, linewidth=0.9, linestyle="--")
        for height_um in (top, bottom):
            axes.axhline(height_um, color=_RED, linewidth=0.6, linestyle=":")
        axes.fill([0.0, 0.0, core["Smr1"]], [top, top + core["Spk"], top], color=_RED, alpha=0.2)
        axes.fill([100.0, 100.0, core["Smr2"]], [bottom, bottom - core["Svk"], bottom], color=_RED, alpha=0.2)
        words += (
            f"; core line (dashed) over Sk {core['Sk']:.4g} µm, triangles of Spk {core['Spk']:.4g} µm and "
            f"Svk {core['Svk']:.4g} µm at {core['Smr1']:.1f} % and {core['Smr2']:.1f} %"
        )
    axes.set_xlabel("areal material ratio, %")
    axes.set_ylabel("height, µm")
    axes.set_xlim(0.0, 100.0)
    return picture_of(figure, words)


def spectrum_picture(found: MeasuredSpectrum, factor: int) -> Picture:
    """Return the power spectral density with its uncertainty."""
    figure, axes = _figure(7.0, 2.8)
    per_mm, density = 1000.0 * found.spectrum.per_um, found.spectrum.density_um3
    if found.sigma_um3 is not None:
        low = np.maximum(density - factor * found.sigma_um3, 1e-3 * density)
        axes.fill_between(per_mm, low, density + factor * found.sigma_um3, color=_BLUE, alpha=0.25, linewidth=0.0)
    axes.loglog(per_mm, density, color=_BLUE, linewidth=1.1)
    axes.set_xlabel("spatial frequency, 1/mm")
    axes.set_ylabel("density, µm³")
    return picture_of(figure, "Power spectral density, averaged over directions")


def _figure(width: float, height: float, *, grid: bool = True) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(width, height), layout="constrained")
    axes = figure.add_subplot()
    if grid:
        axes.grid(visible=True, linewidth=0.3, alpha=0.5)
    return figure, axes


def _plain(text: str) -> str:
    """Return the text, escaped so that matplotlib does not read a formula."""
    return printable(text).replace("$", r"\$")


def picture_of(figure: Figure, caption: str) -> Picture:
    """Return the figure as a PNG in memory."""
    stream = io.BytesIO()
    with warnings.catch_warnings():
        # Characters that the font lacks are drawn as boxes; the report's text has them.
        warnings.filterwarnings("ignore", "Glyph .* missing from", UserWarning)
        figure.savefig(stream, format="png", dpi=DPI, metadata={"Software": None})
    size = figure.get_size_inches() * DPI
    return Picture(caption, stream.getvalue(), (round(float(size[0])), round(float(size[1]))))
