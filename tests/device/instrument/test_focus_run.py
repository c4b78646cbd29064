"""The live focus figure of the whole instrument, while a simulated person turns the lens out of focus and back."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import cv2
import pytest

from device.imaging.frame_measures import IS_SHARP, NEAR_BEST, SEARCH, TURN_BACK, FocusReading
from device.instrument.events import Failed, Info
from device.instrument.instrument import Instrument
from device.instrument.live import MAX_READING_S
from device.store.store import BundleStore
from hal.board_profile import BoardProfile
from hal.clock import VirtualClock
from hal.frame import CameraSettings, RawFrame
from hal.simulator.bench import SimulatedScene
from hal.simulator.hardware import twin_hardware


class UnfocusedScene(SimulatedScene):
    """A world whose lens blurs by `blur_px`, the standard deviation in sensor pixels."""

    blur_px = 0.0

    def expose(self, index: int, began_ns: int, settings: CameraSettings) -> RawFrame:
        frame = super().expose(index, began_ns, settings)
        if not self.blur_px:
            return frame
        mosaic = frame.mosaic.copy()
        for row in (0, 1):
            for column in (0, 1):
                plane = mosaic[row::2, column::2]
                mosaic[row::2, column::2] = cv2.GaussianBlur(plane, (0, 0), 0.5 * self.blur_px)
        return replace(frame, mosaic=mosaic)


@contextmanager
def running(profile: BoardProfile, store: BundleStore) -> Iterator[tuple[Instrument, UnfocusedScene]]:
    bench = UnfocusedScene(profile, VirtualClock(start_ns=5_000_000_000), 1)
    with Instrument(twin_hardware(bench), BundleStore(store.root, bench.clock, boot_id="b0075e1f")) as instrument:
        instrument.step()
        yield instrument, bench


def focused(instrument: Instrument, steps: int = 8) -> FocusReading:
    for _ in range(steps):
        instrument.step()
    reading = instrument.state.focus
    assert reading is not None
    return reading


def test_the_best_is_held_and_the_advice_follows_the_ring(small_twin: BoardProfile, calibrated: BundleStore) -> None:
    with running(small_twin, calibrated) as (instrument, bench):
        assert instrument.state.focus is None
        bench.blur_px = 6.0
        instrument.read_focus(True)
        poor = focused(instrument)
        bench.blur_px = 0.0
        sharp = focused(instrument)
        assert (poor.advice, sharp.advice) == (SEARCH, SEARCH)
        assert sharp.figure > 1.2 * poor.figure
        bench.blur_px = 6.0
        past = focused(instrument)
        assert past.best >= sharp.figure > past.figure / NEAR_BEST
        assert past.advice == TURN_BACK
        bench.blur_px = 0.0
        back = focused(instrument)
        assert back.fraction >= NEAR_BEST
        assert back.advice == IS_SHARP
        instrument.read_focus(False)
        instrument.step()
        assert instrument.state.focus is None
        bench.blur_px = 6.0
        instrument.read_focus(True)
        assert focused(instrument).best < sharp.figure  # it starts anew


def test_it_ends_by_itself_and_says_so(small_twin: BoardProfile, calibrated: BundleStore) -> None:
    with running(small_twin, calibrated) as (instrument, bench):
        instrument.read_focus(True)
        focused(instrument)
        bench.clock.sleep(0.9 * MAX_READING_S)
        focused(instrument)  # the lights stay on
        bench.clock.sleep(0.2 * MAX_READING_S)
        instrument.step()
        assert instrument.state.focus is None
        told = [event.sentence for event in instrument.take_events() if isinstance(event, Info)]
        assert "The focus figure ended after 10 minutes." in told


@pytest.mark.parametrize("calibrates_first", [False, True])
def test_a_calibration_and_the_focus_exclude_each_other(
    small_twin: BoardProfile, calibrated: BundleStore, calibrates_first: bool
) -> None:
    with running(small_twin, calibrated) as (instrument, _):
        if calibrates_first:
            instrument.start_calibration(3.0)
            instrument.step()
            instrument.read_focus(True)
            instrument.step()
            assert any("during a calibration" in e.sentence for e in instrument.take_events() if isinstance(e, Failed))
        else:
            instrument.read_focus(True)
            focused(instrument)
            instrument.start_calibration(3.0)
            instrument.step()
        assert instrument.state.activity == "calibrating"
        assert instrument.state.focus is None
