"""Lights that are out, weak or flagged, from what the border of a press shows and what the driver reports."""

import numpy as np
import pytest

from device.imaging.flat_field import NormalizedImage
from device.quality.verdict import border_levels, light_complaint

NAMES = ("red", "green", "blue")


def intensity(levels: tuple[float, float, float], shape: tuple[int, int] = (60, 80)) -> NormalizedImage:
    values = np.broadcast_to(np.float32(levels), (*shape, 3)).copy()
    return NormalizedImage(values, np.ones(shape, np.bool_), np.zeros(shape, np.bool_))


def test_the_border_is_measured_whatever_is_pressed_inside_it() -> None:
    seen = intensity((1.0, 0.5, 0.9))
    seen.values[10:-10, 10:-10] = 7.0
    seen.values[:10, :20] = 0.1
    assert border_levels(seen) == pytest.approx((1.0, 0.5, 0.9))


def test_what_the_reference_did_not_light_is_not_measured() -> None:
    seen = intensity((1.0, 1.0, 1.0))
    seen.values[:, :40] = 0.0
    seen.valid[:, :40] = False
    assert border_levels(seen) == pytest.approx((1.0, 1.0, 1.0))
    seen.valid[:] = False
    assert border_levels(seen) is None


@pytest.mark.parametrize(
    ("levels", "flags", "level", "reason"),
    [
        ((0.1, 0.9, 1.0), {}, "retake", "light red is at 10% of its calibrated level: check its LEDs"),
        ((1.0, 0.58, 1.0), {"green": "open"}, "retake", "light green is at 58% .* and the driver reports open: check"),
        ((0.1, 0.9, 0.2), {}, "retake", "light red is at 10% .*; light blue is at 20%"),
        ((1.0, 1.0, 0.85), {}, "doubtful", "light blue is at 85% .*calibrate again"),
        ((1.0, 1.0, 1.0), {"blue": "short"}, "doubtful", "light blue is at 100% .* the driver reports short: run"),
        (None, {"red": "hot"}, "retake", "light red: the driver reports hot: check"),
    ],
)
def test_a_light_that_is_not_as_calibrated_is_named(
    levels: tuple[float, float, float] | None, flags: dict[str, str], level: str, reason: str
) -> None:
    complaint = light_complaint(levels, NAMES, flags)
    assert complaint is not None
    assert complaint[0] == level
    with pytest.raises(AssertionError, match=reason):
        raise AssertionError(complaint[1])


@pytest.mark.parametrize("levels", [(1.0, 1.0, 1.0), (0.95, 0.93, 1.08), None])
def test_lights_as_they_were_calibrated_are_no_complaint(levels: tuple[float, float, float] | None) -> None:
    assert light_complaint(levels, NAMES, {}) is None
