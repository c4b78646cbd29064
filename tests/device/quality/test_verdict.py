import numpy as np
import pytest

from device.bundles.scan import VerdictRecord
from device.errors import CalibrationMismatch
from device.imaging.flat_field import LinearFrame, NormalizedImage
from device.imaging.frame_measures import check_channel_order
from device.quality.verdict import LIGHTS_UNKNOWN, Evidence, InstrumentContext

SHAPE = (120, 160)
NAMES = ("red", "green", "blue")


def judge(frame: LinearFrame, intensity: NormalizedImage | None, change: float | None = 0.0) -> VerdictRecord:
    known = InstrumentContext(light_change=dict.fromkeys(NAMES, change))
    return Evidence.of(frame, intensity, NAMES, {}, known).verdict()


def frame(level: float = 0.5, clipped_fraction: float = 0.0) -> LinearFrame:
    clipped = np.zeros(SHAPE, bool)
    clipped.ravel()[: int(clipped_fraction * clipped.size)] = True
    return LinearFrame(np.full((*SHAPE, 3), level, np.float32), clipped)


def intensity(pressed: bool) -> NormalizedImage:
    values = np.ones((*SHAPE, 3), np.float32)
    if pressed:
        values[40:80, 50:110] = (1.4, 0.7, 0.9)
    return NormalizedImage(values, np.ones(SHAPE, bool), np.zeros(SHAPE, bool))


def test_a_pressed_and_exposed_frame_is_good() -> None:
    verdict = judge(frame(), intensity(pressed=True))
    assert verdict.level == "good"
    assert verdict.figures["contact_share"] == pytest.approx(2400 / 19200, rel=0.2)


@pytest.mark.parametrize(
    ("given", "pressed", "level", "word"),
    [
        (frame(level=0.002), True, "retake", "black"),
        (frame(clipped_fraction=0.2), True, "retake", "saturated"),
        (frame(clipped_fraction=0.02), True, "doubtful", "saturated"),
        (frame(), False, "doubtful", "press harder"),
    ],
)
def test_each_fault_has_its_level_and_reason(given: LinearFrame, pressed: bool, level: str, word: str) -> None:
    verdict = judge(given, intensity(pressed))
    assert verdict.level == level
    assert word in verdict.reason


def test_a_verdict_does_not_need_an_intensity() -> None:
    verdict = judge(frame(), None)
    assert verdict.level == "good"
    assert verdict.figures["contact_share"] is None


def test_lights_that_are_not_known_are_no_lights_that_are_right() -> None:
    verdict = judge(frame(), intensity(pressed=True), change=None)
    assert (verdict.level, verdict.reason) == ("doubtful", LIGHTS_UNKNOWN)
    assert verdict.figures["light_change_green"] is None


@pytest.mark.parametrize("order", [(2, 1, 0), (1, 0, 2), (0, 2, 1), (1, 2, 0)])
def test_swapped_channels_are_noticed_even_under_a_press(order: tuple[int, int, int]) -> None:
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]] / 160.0
    flat_field = np.stack([0.3 + 0.2 * column, 0.5 - 0.2 * row, 0.35 + 0.1 * row], axis=-1).astype(np.float32)
    pressed = flat_field * intensity(pressed=True).values
    none = np.zeros(SHAPE, bool)
    check_channel_order(LinearFrame(pressed, none), flat_field, "a.png")
    check_channel_order(LinearFrame(0.9 * pressed, none), flat_field, "dimmed.png")
    with pytest.raises(CalibrationMismatch, match=r"b\.png: the channels are in the order"):
        check_channel_order(LinearFrame(pressed[..., order], none), flat_field, "b.png")
