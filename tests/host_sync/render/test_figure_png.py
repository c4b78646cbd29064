"""A figure's PNG has the pixels that matplotlib's own would have."""

from __future__ import annotations

from io import BytesIO

import cv2
import numpy as np
import pytest
from matplotlib.figure import Figure

from host_sync.render.picture_file import figure_png


def figure() -> Figure:
    made = Figure(figsize=(3.0, 2.0), layout="constrained")
    bars, picture = made.subplots(1, 2)
    bars.bar(range(3), (1.0, 3.0, 2.0))
    bars.set_xticks(range(3), ["press-00", "press-01", "press-02"], rotation=90)
    picture.imshow(np.random.default_rng(0).uniform(size=(30, 40, 3)))
    return made


@pytest.mark.parametrize("dpi", [90, 120])
def test_pixels_are_those_that_matplotlib_saves(dpi: int) -> None:
    stream = BytesIO()
    figure().savefig(stream, dpi=dpi, format="png")
    saved, ours = (
        cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
        for data in (stream.getvalue(), figure_png(figure(), dpi))
    )
    assert saved is not None
    assert ours is not None
    assert np.array_equal(saved[..., :3], ours)
    assert (saved[..., 3] == 255).all()
