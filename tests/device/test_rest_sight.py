"""What a frame tells of the lights: rest is believed, pressed skin is not taken for a weak light."""

from collections.abc import Callable

import numpy as np
import pytest

from device.drift_watch import DriftWatch
from device.gel_defects import gel_defects
from device.photometry import IntensityImage, LinearFrame, bin_bayer, blurred_reference, divide
from device.rest_sight import RestModel, RestSight
from device.scanning.capture import CapturePlan, capture
from hal.hardware import Hardware
from hal.interfaces import PressObject
from hal.twin.bench import Bench
from hal.twin.scene import Press
from hal.twin.surfaces import Block, Plane, Surface, Texture

WHOLE_FIELD = Block(20.0, 20.0)
See = Callable[[], RestSight | None]


@pytest.fixture
def see(hardware: Hardware, bench: Bench) -> See:
    """What the twin's present frame shows, against a reference in air."""
    with hardware:
        plan = CapturePlan.of_board(hardware)
        reference = bin_bayer(capture(hardware, plan), 2)
    divisor = blurred_reference(reference)
    model = RestModel.of(divide(reference, divisor))

    def look() -> RestSight | None:
        with hardware:
            return model.see(divide(bin_bayer(capture(hardware, plan), 2), divisor))

    return look


@pytest.mark.parametrize("share", [1.0, 0.99, 0.97, 0.8])
def test_the_level_of_a_light_is_read_from_skin_at_rest(see: See, bench: Bench, share: float) -> None:
    bench.faults.dimmed["red"] = share
    sight = see()
    assert sight is not None
    assert sight.is_whole
    red, green, blue = sight.levels
    assert red == pytest.approx(1.0 - 0.9 * (1.0 - share), abs=0.003)
    assert min(green, blue) > 1.0 - 0.2 * (1.0 - share) - 0.001


def test_untouched_skin_beside_a_press_is_enough(see: See, bench: Bench, hardware: Hardware) -> None:
    bench.faults.dimmed["blue"] = 0.97
    hardware.operator.ask(PressObject("sphere"))
    sight = see()
    assert sight is not None
    assert not sight.is_whole
    assert sight.levels[2] == pytest.approx(0.973, abs=0.003)


@pytest.mark.parametrize(
    ("surface", "depth_mm"),
    [
        (WHOLE_FIELD, 0.5),
        (Plane(WHOLE_FIELD, 0.0175, 0.0), 0.85),
        (Plane(WHOLE_FIELD, 0.0, 0.009), 0.6),
        (Texture(WHOLE_FIELD, 0.012, 0.5, 0.15), 0.4),
    ],
)
def test_a_thing_over_the_whole_field_is_never_taken_for_weak_lights(
    see: See, bench: Bench, surface: Surface, depth_mm: float
) -> None:
    bench.place(Press(surface, (0.0, 0.0), 0.0, depth_mm))
    watch = DriftWatch()
    watch.see(see())
    assert max(abs(change) for change in watch.changes or (0.0,)) < 0.02


def test_a_tilt_under_distant_lights_is_no_drift() -> None:
    rng = np.random.default_rng(0)
    rest = IntensityImage(
        rng.normal(1.0, 0.01, (120, 160, 3)).astype(np.float32), np.ones((120, 160), bool), np.zeros((120, 160), bool)
    )
    tilted = IntensityImage(rest.values * np.float32((1.02, 0.99, 0.99)), rest.valid, rest.clipped)
    dimmed = IntensityImage(rest.values * np.float32((0.98, 1.0, 1.0)), rest.valid, rest.clipped)
    model = RestModel.of(rest)
    leaning = model.see(tilted)
    assert leaning is not None
    assert not DriftWatch().see(leaning)
    sight = model.see(dimmed)
    assert sight is not None
    assert sight.levels == pytest.approx((0.98, 1.0, 1.0), abs=1e-3)


def test_large_steps_want_a_whole_field_at_rest() -> None:
    watch = DriftWatch()
    assert watch.changes is None
    assert not watch.see(RestSight((0.95, 1.0, 1.0), 0.5, 0.001))
    assert watch.see(RestSight((0.95, 1.0, 1.0), 0.99, 0.001))
    assert watch.changes == pytest.approx((-0.05, 0.0, 0.0))
    watch.scanned(None)
    assert watch.unseen_scans == 1
    watch.scanned(RestSight((0.945, 1.0, 1.0), 0.5, 0.001))
    assert watch.unseen_scans == 0


def test_scratches_and_dust_are_found_and_the_lights_own_slope_is_not() -> None:
    row, column = np.mgrid[:136, :182].astype(np.float32)
    rgb = np.stack([0.3 + 0.001 * column, 0.5 - 0.002 * row, 0.3 + 0.001 * row], axis=-1)
    rgb += np.random.default_rng(0).normal(0.0, 0.003, rgb.shape)
    clean = gel_defects(LinearFrame(rgb.astype(np.float32), np.zeros(rgb.shape[:2], bool)))
    assert clean.mean() < 1e-3
    rgb[60:63, 20:120] *= 0.85
    rgb[100:104, 150:154] *= 0.7
    worn = gel_defects(LinearFrame(rgb.astype(np.float32), np.zeros(rgb.shape[:2], bool)))
    assert worn[61, 30:110].mean() > 0.95
    assert worn[101:103, 151:153].all()
    assert worn.mean() < 0.06
