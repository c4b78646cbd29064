"""The press of a movie in the details of a scan."""

from __future__ import annotations

import pytest

from device.bundles.scan import MovieFrameRecord, MovieRecord
from device.tui.drawing.cells import ColourDepth
from device.tui.screens.scans import BARS, movie_text


def movie(depths_um: tuple[float | None, ...]) -> MovieRecord:
    frames = tuple(
        MovieFrameRecord(f"movie-{i:03}.tif", 100.0 * i, i / (2.0 * len(depths_um)), depth_um)
        for i, depth_um in enumerate(depths_um)
    )
    return MovieRecord(2, len(frames) - 1, frames)


DEEPENING = movie(tuple(10.0 * i for i in range(41)))


def test_bars_rise_as_the_press_deepens() -> None:
    assert movie_text(DEEPENING, "full") == "Contact  ▂▃▄▆▇█ 49 %, depth  ▂▃▄▆▇█ 400 µm"


@pytest.mark.parametrize(("depth", "blocks"), [("full", " ▁▂▃▄▅▆▇█"), ("sixteen", " ▄█")])
def test_a_plain_console_is_given_blocks_that_its_font_has(depth: ColourDepth, blocks: str) -> None:
    bars = movie_text(DEEPENING, depth).removeprefix("Contact ")[:BARS]
    assert set(bars) <= set(blocks)
    assert bars[-1] == "█"


def test_depths_that_nobody_knows_are_left_out() -> None:
    said = movie_text(movie((None, None, None)), "full")
    assert "depth" not in said
    assert said.startswith("Contact ")
