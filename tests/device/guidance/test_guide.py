"""The press guide on the twin's live frames: contact, depth, tilt, motion and light."""

from collections.abc import Callable, Iterator

import numpy as np
import pytest

from device.acquisition.capture import CaptureSettings, capture
from device.acquisition.scanner import Scanner
from device.guidance.guide import MAX_COLUMNS, GuideModel, GuideReading, PressGuide, downsample_bayer, downsample_step
from device.store.store import BundleStore
from hal.hardware import Hardware
from hal.simulator.bench import Faults, SimulatedScene
from hal.simulator.operator import specimen
from hal.simulator.scene import Press
from hal.simulator.surfaces import Block, Plane, Sphere, Surface


class Hand:
    """Live frames of what is pressed."""

    def __init__(self, hardware: Hardware, bench: SimulatedScene, scanner: Scanner) -> None:
        record = scanner.calibration.record
        reference = scanner.calibration.reference()
        slab_um = 1e3 * hardware.profile.gel.slab_thickness_mm
        self.bench = bench
        self.guide = PressGuide(GuideModel.prepare(reference, scanner.model.slopes, record.pixel_pitch_um, slab_um))
        self._hardware = hardware
        self._plan = scanner.plan

    def look(self, frames: int = 1) -> GuideReading:
        for _ in range(frames):
            self._hardware.clock.sleep(0.05)
            reading = self.guide.read(downsample_bayer(capture(self._hardware, self._plan)))
        return reading

    def press(self, surface: Surface, depth_mm: float, x_mm: float = 0.0) -> GuideReading:
        self.bench.place(Press(surface, (x_mm, 0.0), 0.0, depth_mm))
        return self.look(12)


@pytest.fixture
def hand(hardware: Hardware, calibrated: BundleStore, bench: SimulatedScene) -> Iterator[Hand]:
    with hardware:
        yield Hand(hardware, bench, Scanner(hardware, calibrated))


def test_air_is_distinguished_from_contact_and_depth_is_measured(hand: Hand) -> None:
    air = hand.look(2)
    assert air.in_air
    assert air.advice == "press"
    for depth_mm in (0.6, 1.0):
        reading = hand.press(Sphere(3.0), depth_mm)
        assert reading.depth_um == pytest.approx(1e3 * depth_mm, rel=0.2)
        assert reading.contact_fraction is not None
        assert 0.05 < reading.contact_fraction < 0.4
        assert reading.advice == "ready"


def test_a_press_near_the_slabs_limit_is_too_deep(hand: Hand) -> None:
    assert hand.press(Sphere(3.0), 1.45).advice == "too deep"


def test_a_tilted_face_is_reported_with_the_side_that_is_deeper(hand: Hand) -> None:
    tilted = hand.press(Plane(Block(3.0, 3.0), 0.14, 0.0), 0.8)
    assert tilted.tilt_deg == pytest.approx(8.0, abs=2.0)
    assert tilted.tilt_towards == "right"
    assert tilted.advice == "press flatter"
    level = hand.press(Plane(Block(4.0, 4.0), 0.0, 0.0), 0.5)
    assert level.tilt_deg is not None
    assert level.tilt_deg < 2.0


def test_motion_is_seen_and_stillness_is_timed(hand: Hand) -> None:
    coin = specimen("coin")
    hand.press(coin.surface, coin.indentation_mm)
    moved = hand.press(coin.surface, coin.indentation_mm, x_mm=0.4)
    assert moved.still_s > 0.4
    hand.bench.place(Press(coin.surface, (0.8, 0.0), 0.0, coin.indentation_mm))
    moving = hand.look()
    assert moving.still_s == 0.0
    assert moving.motion is not None
    assert moving.motion > 0.05
    assert moving.advice == "hold still"


def test_the_guide_sees_contact_under_lights_that_have_aged(hand: Hand) -> None:
    hand.bench.faults.dimmed.update(red=0.9, green=0.9, blue=0.9)
    assert not hand.look(2).in_air
    hand.guide.set_light_levels((0.9, 0.9, 0.9))
    assert hand.look(2).in_air


FAULTS: dict[str, Callable[[Faults], None]] = {
    "open": lambda faults: faults.open_lights.add("red"),
    "two open": lambda faults: faults.open_lights.update({"red", "blue"}),
    "broken": lambda faults: setattr(faults, "lights_broken", True),
    "dim": lambda faults: faults.dimmed.update(green=0.3),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_no_press_is_deeper_than_the_gel_under_a_broken_light(hand: Hand, fault: str) -> None:
    FAULTS[fault](hand.bench.faults)
    coin = specimen("coin")
    for reading in (hand.look(2), hand.press(coin.surface, coin.indentation_mm)):
        assert reading.advice in ("lights", "too dark")
        assert (reading.depth_um, reading.depth_fraction, reading.contact_fraction) == (None, None, None)
        assert reading.tilt_deg is None


def test_without_a_reference_only_light_is_judged(hand: Hand) -> None:
    hand.guide = PressGuide(None)
    assert hand.look(2).advice == "calibrate"
    hand.bench.faults.lights_broken = True
    dark = hand.look(2)
    assert dark.advice == "too dark"
    assert dark.contact_fraction is None


def test_frames_of_any_sensor_become_small_images() -> None:
    for shape in ((272, 364), (1088, 1456), (1520, 2028), (3040, 4056)):
        step = downsample_step(shape)
        assert step % 2 == 0
        assert MAX_COLUMNS / 2 < shape[1] // step <= MAX_COLUMNS


def test_downsampling_keeps_colour_and_saturation(hardware: Hardware) -> None:
    with hardware:
        frame = capture(hardware, CaptureSettings.of_board(hardware))
    frame.mosaic[: frame.shape[0] // 2] = 4095
    small = downsample_bayer(frame)
    assert small.clipped_fraction == pytest.approx(0.5, abs=0.02)
    assert np.allclose(small.rgb[0, 0], 1.0)
    assert small.picture().dtype == np.uint8
