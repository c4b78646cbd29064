"""The picture that a demo ends with: frame, quick look, relief and uncertainty of each scan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from device.surface.fields import Float32Array, HeightMap
from host_sync.render.figures import draw_relief

TITLES: Final = ("frame", "quick look on the handheld", "relief", "± of the height, µm (k = 1)")
REDUCTION: Final = 2


@dataclass(frozen=True, eq=False)
class StoryRow:
    """A scan with what is shown of it.

    frame_rgb : float32 array of shape (H, W, 3), linear light as a fraction of full scale
    quick_look : uint8 array, the handheld's own picture
    sigma_um : float32 array of shape (H, W), standard uncertainty of the height
    """

    title: str
    frame_rgb: Float32Array
    quick_look: NDArray[np.uint8]
    height: HeightMap
    sigma_um: Float32Array


def write_story(rows: Sequence[StoryRow], path: Path) -> None:
    """Write the picture, a row per scan."""
    figure = Figure(figsize=(19.0, 4.0 * len(rows) + 0.3), layout="constrained")
    for number, (row, axes) in enumerate(zip(rows, figure.subplots(len(rows), 4, squeeze=False), strict=True)):
        frame, look, relief, sigma = axes
        frame.imshow(np.clip(1.3 * row.frame_rgb[::REDUCTION, ::REDUCTION], 0.0, 1.0) ** (1 / 2.2))
        look.imshow(row.quick_look, cmap="gray", vmin=0, vmax=255)
        draw_relief(relief, row.height, "")
        shown = sigma.imshow(row.sigma_um[::REDUCTION, ::REDUCTION], cmap="cividis", vmin=0.0)
        figure.colorbar(shown, cax=sigma.inset_axes((1.02, 0.0, 0.03, 1.0)))
        for one in (frame, look, sigma):
            one.set_xticks([])
            one.set_yticks([])
        for one, title in zip(axes, TITLES, strict=True):
            one.set_title(title if number == 0 else "")
        frame.set_ylabel(row.title)
    figure.savefig(path, dpi=100)
