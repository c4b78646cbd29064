"""The plain console: the font that its unit sets holds all that is drawn there, and the usual one does not."""

from pathlib import Path

import pytest
from console_font import DRAWN, FOLDER, SCREEN_FONTS, glyphs_of

SNAPSHOTS = Path(__file__).parent / "snapshots"


def glyphs(font: str) -> set[str]:
    path = FOLDER / f"{font}.psf.gz"
    if not path.exists():
        pytest.skip(f"{path} is not there: install console-setup-linux (make test-deps)")
    return glyphs_of(path)


@pytest.mark.parametrize("font", SCREEN_FONTS)
def test_the_font_holds_what_is_drawn(font: str) -> None:
    assert DRAWN - glyphs(font) == set()


def test_the_usual_font_would_not_do() -> None:
    assert {"▀", "▄"} & glyphs("Lat15-Terminus16") == set()


def test_every_screen_without_colours_keeps_to_these_glyphs() -> None:
    screens = list(SNAPSHOTS.glob("*-mono.txt"))
    assert len(screens) > 5
    drawn = {glyph for screen in screens for glyph in screen.read_text(encoding="utf-8")} - {"\n"}
    assert drawn - DRAWN == set()
