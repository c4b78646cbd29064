"""The press coach on the twin's live frames: contact, depth, tilt, motion, light, and what it costs."""

from collections.abc import Iterator

import numpy as np
import pytest

from device.bundle_store import BundleStore
from device.coaching.coach import Coach, CoachModel
from device.coaching.coach_reading import CoachReading
from device.coaching.thin_frame import MOST_COLUMNS, thin, thinning
from device.scanning.capture import CapturePlan, capture
from device.scanning.scanner import Scanner
from hal.hardware import Hardware
from hal.twin.bench import Bench
from hal.twin.gallery import exhibit
from hal.twin.scene import Press
from hal.twin.surfaces import Block, Plane, Sphere, Surface


class Hand:
    """Live frames of whatever is pressed."""

    def __init__(self, hardware: Hardware, bench: Bench, scanner: Scanner) -> None:
        record = scanner.calibration.record
        reference = scanner.calibration.reference()
        slab_um = 1e3 * hardware.profile.gel.slab_thickness_mm
        self.bench = bench
        self.coach = Coach(CoachModel.prepare(reference, scanner.model.slopes, record.pixel_pitch_um, slab_um))
        self._hardware = hardware
        self._plan = scanner.plan

    def look(self, frames: int = 1) -> CoachReading:
        for _ in range(frames):
            self._hardware.clock.sleep(0.05)
            reading = self.coach.look(thin(capture(self._hardware, self._plan)))
        return reading

    def press(self, surface: Surface, depth_mm: float, x_mm: float = 0.0) -> CoachReading:
        self.bench.place(Press(surface, (x_mm, 0.0), 0.0, depth_mm))
        return self.look(12)


@pytest.fixture
def hand(hardware: Hardware, calibrated: BundleStore, bench: Bench) -> Iterator[Hand]:
    with hardware:
        yield Hand(hardware, bench, Scanner(hardware, calibrated))


def test_air_is_told_from_contact_and_depth_is_measured(hand: Hand) -> None:
    air = hand.look(2)
    assert air.in_air
    assert air.advice == "press"
    for depth_mm in (0.6, 1.0):
        reading = hand.press(Sphere(3.0), depth_mm)
        assert reading.depth_um == pytest.approx(1e3 * depth_mm, rel=0.2)
        assert reading.contact_share is not None
        assert 0.05 < reading.contact_share < 0.4
        assert reading.advice == "ready"


def test_a_press_near_the_slabs_limit_is_too_deep(hand: Hand) -> None:
    assert hand.press(Sphere(3.0), 1.45).advice == "too deep"


def test_a_tilted_face_is_told_with_the_side_that_is_deeper(hand: Hand) -> None:
    tilted = hand.press(Plane(Block(3.0, 3.0), 0.14, 0.0), 0.8)
    assert tilted.tilt_deg == pytest.approx(8.0, abs=2.0)
    assert tilted.tilt_towards == "right"
    assert tilted.advice == "press flatter"
    level = hand.press(Plane(Block(4.0, 4.0), 0.0, 0.0), 0.5)
    assert level.tilt_deg is not None
    assert level.tilt_deg < 2.0


def test_motion_is_seen_and_stillness_is_timed(hand: Hand) -> None:
    coin = exhibit("coin")
    hand.press(coin.surface, coin.indentation_mm)
    moved = hand.press(coin.surface, coin.indentation_mm, x_mm=0.4)
    assert moved.still_s > 0.4
    hand.bench.place(Press(coin.surface, (0.8, 0.0), 0.0, coin.indentation_mm))
    moving = hand.look()
    assert moving.still_s == 0.0
    assert moving.motion is not None
    assert moving.motion > 0.05
    assert moving.advice == "hold still"


def test_the_coach_sees_contact_under_lights_that_have_aged(hand: Hand) -> None:
    hand.bench.faults.dimmed.update(red=0.9, green=0.9, blue=0.9)
    assert not hand.look(2).in_air
    hand.coach.expect((0.9, 0.9, 0.9))
    assert hand.look(2).in_air


def test_without_a_reference_only_light_is_judged(hand: Hand) -> None:
    hand.coach = Coach(None)
    assert hand.look(2).advice == "calibrate"
    hand.bench.faults.lights_broken = True
    dark = hand.look(2)
    assert dark.advice == "too dark"
    assert dark.contact_share is None


def test_any_sensor_is_thinned_to_a_small_picture() -> None:
    for shape in ((272, 364), (1088, 1456), (1520, 2028), (3040, 4056)):
        step = thinning(shape)
        assert step % 2 == 0
        assert MOST_COLUMNS / 2 < shape[1] // step <= MOST_COLUMNS


def test_thinning_keeps_colour_and_saturation(hardware: Hardware) -> None:
    with hardware:
        frame = capture(hardware, CapturePlan.of_board(hardware))
    frame.mosaic[: frame.shape[0] // 2] = 4095
    small = thin(frame)
    assert small.clipped_share == pytest.approx(0.5, abs=0.02)
    assert np.allclose(small.rgb[0, 0], 1.0)
    assert small.picture().dtype == np.uint8
