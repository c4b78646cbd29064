"""The live picture sends a terminal what changes, and no noise."""

from __future__ import annotations

import asyncio

import numpy as np
from textual.app import App, ComposeResult
from textual.geometry import Region

from device.tui.drawing.height_picture import shown_colours
from device.tui.widgets.cells_view import LiveView

SHAPE = (96, 128, 3)


def still(seed: int) -> np.ndarray:
    """A frame of untouched skin, with the noise of a camera."""
    shade = np.linspace(60.0, 180.0, SHAPE[1])[None, :, None] + np.zeros(SHAPE)
    return np.rint(shade + np.random.default_rng(seed).normal(0.0, 3.0, SHAPE)).astype(np.uint8)


def test_noise_changes_no_colour_and_a_press_does() -> None:
    first = shown_colours(still(0), 20, 40)
    for seed in range(1, 10):
        assert np.array_equal(shown_colours(still(seed), 20, 40, first), first)
    pressed = still(10)
    pressed[30:60, 40:80] += 60
    changed = (shown_colours(pressed, 20, 40, first) != first).any(axis=-1)
    assert changed.mean() > 0.05
    assert not changed[:5].any()
    assert shown_colours(still(0), 10, 40, first).shape != first.shape


def test_only_cells_that_differ_are_drawn_again() -> None:
    drawn: list[Region] = []

    class Counted(LiveView):
        def refresh(self, *regions: Region, **options: bool) -> Counted:  # type: ignore[override]
            drawn.extend(regions)
            return super().refresh(*regions, **options)

    class Bench(App[None]):
        def compose(self) -> ComposeResult:
            yield Counted("full")

    async def watch() -> None:
        app = Bench()
        async with app.run_test(size=(40, 16)) as pilot:
            view = app.query_one(Counted)
            view.show(still(0))
            await pilot.pause()
            drawn.clear()
            view.show(still(1))
            assert drawn == []
            pressed = still(2)
            pressed[30:60, 40:80] += 60
            view.show(pressed)
            await pilot.pause()
            assert drawn
            assert max(region.width for region in drawn) < 20

    asyncio.run(watch())
