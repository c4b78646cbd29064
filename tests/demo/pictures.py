"""The demo's pictures: frame, quick look, relief, and error maps with the paper's level curves."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from numpy.typing import NDArray

from device.surface import Float32Array, HeightMap
from host_sync.render.picture_file import draw_relief, figure_pixels, figure_png
from tests.demo.truth_judge import Judgement

REDUCTION = 2
TITLES = ("frame", "quick look on the device", "relief", "height error", "angular error")


@dataclass(frozen=True, eq=False)
class Chapter:
    """One scan of the demo with everything to show of it."""

    title: str
    frame_rgb: Float32Array
    quick_look: NDArray[np.uint8]
    height: HeightMap
    judgement: Judgement


def write_pictures(chapter: Chapter, folder: Path) -> None:
    """Write a page for one scan."""
    figure = Figure(figsize=(16.0, 9.6), layout="constrained")
    figure.suptitle(chapter.title, fontsize=15)
    axes = figure.subplots(2, 3).ravel()
    _draw(chapter, list(axes[:5]), titles=True)
    _draw_errors(axes[5], chapter.judgement)
    (folder / "story.png").write_bytes(figure_png(figure, 110))


def summary_row(chapter: Chapter, *, titles: bool) -> NDArray[np.uint8]:
    """A scan's row of the summary picture: uint8 array of shape (H, W, 3), taller when it has the columns' titles."""
    figure = Figure(figsize=(22.0, 4.0 if titles else 3.7), layout="constrained")
    axes = list(figure.subplots(1, 5))
    _draw(chapter, axes, titles=titles)
    axes[0].set_ylabel(chapter.title, fontsize=13)
    return figure_pixels(figure, 90).copy()


def _draw(chapter: Chapter, axes: list[Axes], *, titles: bool) -> None:
    frame, look, relief, height, angle = axes
    frame.imshow(np.clip(1.3 * chapter.frame_rgb[::REDUCTION, ::REDUCTION], 0.0, 1.0) ** (1 / 2.2))
    look.imshow(chapter.quick_look, cmap="gray", vmin=0, vmax=255)
    draw_relief(relief, chapter.height, "")
    judgement = chapter.judgement
    _draw_height_error(height, judgement)
    _draw_angular_error(angle, judgement)
    for one in (frame, look, height, angle):
        one.set_xticks([])
        one.set_yticks([])
    relief.set_xlabel("mm")
    relief.set_ylabel("")
    notes = ("", "", "", ": curves at 2 % and 4 % of R", ": curves at 2° and 4°")
    for one, title, note in zip(axes, TITLES, notes, strict=True):
        one.set_title(title + note if titles else "", fontsize=12)


def _draw_height_error(axes: Axes, judgement: Judgement) -> None:
    """Height error in µm, violet low and orange high, with level curves as in the paper's Fig. 5."""
    limit_um = 0.02 * judgement.ball_radius_um
    error = judgement.height_um[::REDUCTION, ::REDUCTION]
    shown = axes.imshow(error, cmap="PuOr_r", vmin=-limit_um, vmax=limit_um, interpolation="nearest")
    _scale(axes, shown, "µm")
    _draw_levels(axes, np.abs(error) / judgement.ball_radius_um * 100.0, judgement.judged)


def _draw_angular_error(axes: Axes, judgement: Judgement) -> None:
    """Error of the normal in degrees, dark where correct, with level curves as in the paper's Fig. 5."""
    error = judgement.angle_deg[::REDUCTION, ::REDUCTION]
    shown = axes.imshow(error, cmap="cividis", vmin=0.0, vmax=4.0, interpolation="nearest")
    _scale(axes, shown, "degrees")
    _draw_levels(axes, error, judgement.judged)


def _scale(axes: Axes, shown: AxesImage, label: str) -> None:
    figure = axes.get_figure()
    if isinstance(figure, Figure):
        figure.colorbar(shown, cax=axes.inset_axes((1.02, 0.0, 0.03, 1.0)), label=label)


def _draw_levels(axes: Axes, error: Float32Array, judged: NDArray[np.bool_]) -> None:
    """Curves at 2 (black) and 4 (white) and, dotted, the border of the evaluated area; `error` is reduced already."""
    judged = judged[::REDUCTION, ::REDUCTION]
    smooth = cv2.GaussianBlur(np.asarray(error, np.float32), (0, 0), 2.0 / REDUCTION)
    inside = np.where(judged, smooth, 0.0)
    if inside.max() > 2.0:
        axes.contour(inside, levels=[2.0, 4.0], colors=["black", "white"], linewidths=1.1)
    axes.contour(judged.astype(np.float32), levels=[0.5], colors=["dimgray"], linewidths=0.8, linestyles=":")


def _draw_errors(axes: Axes, judgement: Judgement) -> None:
    """Histogram of pixels within a given angle."""
    errors = np.sort(judgement.angle_deg[judgement.judged])[::50]
    axes.plot(errors, np.linspace(0.0, 100.0, len(errors)), color="#4477aa")
    for limit, style in ((2.0, "--"), (4.0, ":")):
        axes.axvline(limit, color="black", linestyle=style, linewidth=1.0)
    axes.set_xlim(0.0, 6.0)
    axes.set_ylim(0.0, 101.0)
    axes.set_title("angular error, cumulated")
    axes.set_xlabel("degrees (lines: 2° and 4°)")
    axes.set_ylabel("% of contact pixels")
