"""Heights in terminal cells: at any size and with any number of colours, what is shown is what was measured."""

import numpy as np
import pytest
from console_font import DRAWN

from device.surface import HeightMap
from device.tui.drawing.cells import HATCH, OWN, fitted_shape, resampled
from device.tui.drawing.height_picture import Room, height_picture
from device.tui.drawing.relief import (
    HeightRange,
    ProfileCursor,
    height_text,
    length_bar,
    length_text,
    profile_cells,
    profile_um,
    reading,
    relief_cells,
    round_step,
    ticks,
)


def dome(rows: int = 96, columns: int = 128, pitch_um: float = 50.0) -> HeightMap:
    row, column = np.mgrid[:rows, :columns].astype(np.float32)
    distance = np.hypot(row - rows / 2, column - columns / 2) / (rows / 2)
    return HeightMap((300.0 * np.clip(1.0 - distance**2, 0.0, None)).astype(np.float32), pitch_um)


@pytest.mark.parametrize("depth", ["full", "sixteen", "mono"])
@pytest.mark.parametrize("size", [(1, 1), (2, 9), (5, 23), (6, 24), (17, 40), (24, 80), (70, 200)])
def test_a_picture_fits_any_room(depth: str, size: tuple[int, int]) -> None:
    cells = height_picture(dome(), Room(*size, depth), ProfileCursor())
    assert cells.shape == size


@pytest.mark.parametrize("size", [(12, 60), (40, 60), (24, 33)])
def test_proportions_are_kept(size: tuple[int, int]) -> None:
    rows, columns = fitted_shape((96, 128), *size)
    assert columns / (2 * rows) == pytest.approx(128 / 96, rel=0.06)
    assert rows == size[0] or columns == size[1]


@pytest.mark.parametrize("depth", ["full", "sixteen", "mono"])
def test_what_was_not_measured_is_hatched_and_never_a_height(depth: str) -> None:
    height = dome()
    height.z_um[:, 64:] = np.nan
    cells = relief_cells(height, HeightRange.of(height.z_um), (12, 32), depth)
    assert (cells.glyphs[:, 16:] == HATCH).all()
    assert (cells.glyphs[:, :16] != HATCH).all()
    assert (cells.paper[:, 16:] == OWN).all()


def test_a_map_without_a_valid_pixel_is_all_hatch() -> None:
    height = HeightMap(np.full((20, 30), np.nan, np.float32), 10.0)
    assert set("".join(height_picture(height, Room(10, 40, "full")).lines()[0][:15])) == {HATCH}


def test_averages_ignore_what_is_invalid() -> None:
    z_um = np.full((4, 4), 8.0, np.float32)
    z_um[0, 0] = np.nan
    z_um[2:, 2:] = np.nan
    small = resampled(z_um, (2, 2))
    assert small[0, 0] == small[0, 1] == small[1, 0] == 8.0
    assert np.isnan(small[1, 1])


def test_full_colour_is_brighter_where_higher() -> None:
    cells = relief_cells(dome(), HeightRange.of(dome().z_um), (24, 64), "full")
    top, foot = int(cells.ink[12, 32]), int(cells.ink[0, 0])
    assert sum(top.to_bytes(3)) > sum(foot.to_bytes(3))


def test_sixteen_colours_draw_bright_greys_as_ink_only() -> None:
    """A console's background has eight colours."""
    cells = relief_cells(dome(), HeightRange.of(dome().z_um), (24, 64), "sixteen")
    assert set(np.unique(cells.paper)) <= {0, 7}
    assert set(np.unique(cells.ink)) <= {0, 7, 8, 15}


def test_without_colour_there_are_no_colours_and_height_is_shade() -> None:
    cells = relief_cells(dome(), HeightRange.of(dome().z_um), (24, 64), "mono")
    assert (cells.ink == OWN).all()
    assert (cells.paper == OWN).all()
    shades = " ░▒▓█"
    assert shades.index(cells.glyphs[12, 30]) > shades.index(cells.glyphs[1, 1])


@pytest.mark.parametrize("depth", ["sixteen", "mono"])
def test_a_plain_console_has_every_glyph(depth: str) -> None:
    height = dome()
    height.z_um[:30, :30] = np.nan
    for cursor in (None, ProfileCursor(), ProfileCursor("column")):
        lines = height_picture(height, Room(24, 60, depth), cursor).lines()
        assert set("".join(lines)) <= DRAWN


def test_the_legend_stands_where_its_heights_are() -> None:
    lines = height_picture(dome(), Room(21, 60, "full")).lines()
    column = lines[0].index("µm") + 2
    figures = {row: line[column:].strip() for row, line in enumerate(lines[:20]) if row and line[column:].strip()}
    assert len(figures) >= 4
    heights = HeightRange.of(dome().z_um)
    for row, figure in figures.items():
        share = (heights.highest_um - float(figure)) / (heights.highest_um - heights.lowest_um)
        assert row - 1 == pytest.approx(share * 18, abs=1.0)


def test_the_bar_of_length_is_as_long_as_it_says() -> None:
    bar = length_bar(100.0, 60)
    assert bar.endswith("2 mm")
    assert bar.index("┤") - bar.index("├") + 1 == 20


def test_a_profile_is_the_row_under_the_cursor_and_turns_in_place() -> None:
    height = dome()
    cursor = ProfileCursor("row", 0.25, 0.75)
    assert (profile_um(height, cursor) == height.z_um[24]).all()
    assert (profile_um(height, cursor.turned()) == height.z_um[:, 95]).all()
    assert reading(height, cursor) == reading(height, cursor.turned())
    assert reading(height, cursor).startswith("x 4.75 mm  y 1.20 mm  z ")
    height.z_um[24, 95] = np.nan
    assert reading(height, cursor).endswith("z not measured")


def test_a_cursor_stays_on_the_map() -> None:
    cursor = ProfileCursor().moved(5.0, -5.0)
    assert (cursor.line, cursor.point) == (1.0, 0.0)


def test_a_profile_rises_and_falls_and_leaves_gaps_open() -> None:
    profile = np.concatenate([np.linspace(0.0, 80.0, 50), np.full(20, np.nan), np.linspace(80.0, 0.0, 50)])
    cells = profile_cells(profile.astype(np.float32), 0.5, 6, 24, "full")
    filled = (cells.glyphs[:5, :24] != " ").sum(axis=0)
    assert filled[0] < filled[8]
    assert filled[-1] < filled[15]
    assert (cells.glyphs[:5, 11:13] == HATCH).all()
    assert "80 µm" in cells.lines()[0]
    assert cells.glyphs[5, 12] == "▲"


def test_noise_is_not_blown_up_to_relief() -> None:
    z_um = np.random.default_rng(1).normal(0.0, 0.1, (40, 60)).astype(np.float32)
    heights = HeightRange.of(z_um)
    assert heights.highest_um - heights.lowest_um == pytest.approx(4.0)


def test_round_numbers() -> None:
    assert [round_step(span, 4) for span in (3.0, 4.0, 9.0, 1000.0)] == [1.0, 1.0, 5.0, 500.0]
    assert ticks(-215.0, 296.0, 4) == [-200.0, 0.0, 200.0]
    assert [height_text(z_um) for z_um in (-0.04, 3.25, 12.3, -400.0)] == ["0", "3.2", "12", "-400"]
    assert [length_text(length_um) for length_um in (200.0, 5000.0)] == ["200 µm", "5 mm"]
