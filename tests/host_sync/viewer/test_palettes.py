import numpy as np
import pytest

from host_sync.render.shading import palettes

LIGHTNESS = np.array([0.2126, 0.7152, 0.0722])


@pytest.mark.parametrize("name", [name for name in palettes() if name != "difference"])
def test_lightness_alone_shows_high_from_low(name: str) -> None:
    steps = np.array(palettes()[name]) @ LIGHTNESS
    assert (np.diff(steps) > -1.5).all()
    assert (np.diff(steps[::8]) > 0.0).all()
    assert steps[-1] - steps[0] > 120.0


def test_a_differences_ends_are_dark_its_middle_light_and_its_sides_differ_in_blue_and_yellow() -> None:
    colours = np.array(palettes()["difference"])
    steps = colours @ LIGHTNESS
    assert steps.argmax() in range(118, 138)
    assert (np.diff(steps[:120:8]) > 0.0).all()
    assert (np.diff(steps[136::8]) < 0.0).all()
    sides = colours[:, 2] - colours[:, :2].mean(axis=1)
    assert (sides[:110] > 10).all()
    assert (sides[146:] < -10).all()
