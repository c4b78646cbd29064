"""Light levels are read from untouched skin; pressed skin is not mistaken for a weak light."""

from collections.abc import Callable

import numpy as np
import pytest

from device.acquisition.capture import CaptureSettings, capture
from device.imaging.flat_field import LinearFrame, NormalizedImage, bin_bayer, flat_field_correct, make_flat_field
from device.quality.untouched import LightDriftMonitor, ReferenceModel, UntouchedRegion, gel_defects
from hal.hardware import Hardware
from hal.interfaces import PressObject
from hal.simulator.bench import SimulatedScene
from hal.simulator.scene import Press
from hal.simulator.surfaces import Block, Plane, Surface, Texture

WHOLE_FIELD = Block(20.0, 20.0)
Detect = Callable[[], UntouchedRegion | None]


@pytest.fixture
def detect(hardware: Hardware, bench: SimulatedScene) -> Detect:
    """Untouched skin in the twin's present frame, against a reference in air."""
    with hardware:
        plan = CaptureSettings.of_board(hardware)
        reference = bin_bayer(capture(hardware, plan), 2)
    flat_field = make_flat_field(reference)
    model = ReferenceModel.of(flat_field_correct(reference, flat_field))

    def look() -> UntouchedRegion | None:
        with hardware:
            return model.detect(flat_field_correct(bin_bayer(capture(hardware, plan), 2), flat_field))

    return look


@pytest.mark.parametrize("share", [1.0, 0.99, 0.97, 0.8])
def test_the_level_of_a_light_is_read_from_untouched_skin(detect: Detect, bench: SimulatedScene, share: float) -> None:
    bench.faults.dimmed["red"] = share
    region = detect()
    assert region is not None
    assert region.is_whole
    red, green, blue = region.levels
    assert red == pytest.approx(1.0 - 0.9 * (1.0 - share), abs=0.003)
    assert min(green, blue) > 1.0 - 0.2 * (1.0 - share) - 0.001


def test_untouched_skin_beside_a_press_is_enough(detect: Detect, bench: SimulatedScene, hardware: Hardware) -> None:
    bench.faults.dimmed["blue"] = 0.97
    hardware.operator.ask(PressObject("sphere"))
    region = detect()
    assert region is not None
    assert not region.is_whole
    assert region.levels[2] == pytest.approx(0.973, abs=0.003)


@pytest.mark.parametrize(
    ("surface", "depth_mm"),
    [
        (WHOLE_FIELD, 0.5),
        (Plane(WHOLE_FIELD, 0.0175, 0.0), 0.85),
        (Plane(WHOLE_FIELD, 0.0, 0.009), 0.6),
        (Texture(WHOLE_FIELD, 0.012, 0.5, 0.15), 0.4),
    ],
)
def test_an_object_over_the_whole_field_is_never_mistaken_for_weak_lights(
    detect: Detect, bench: SimulatedScene, surface: Surface, depth_mm: float
) -> None:
    bench.place(Press(surface, (0.0, 0.0), 0.0, depth_mm))
    drift = LightDriftMonitor()
    drift.update(detect(), 1)
    assert max(abs(change) for change in drift.changes or (0.0,)) < 0.02


def test_a_tilt_under_distant_lights_is_no_drift() -> None:
    rng = np.random.default_rng(0)
    rest = NormalizedImage(
        rng.normal(1.0, 0.01, (120, 160, 3)).astype(np.float32), np.ones((120, 160), bool), np.zeros((120, 160), bool)
    )
    tilted = NormalizedImage(rest.values * np.float32((1.02, 0.99, 0.99)), rest.valid, rest.clipped)
    dimmed = NormalizedImage(rest.values * np.float32((0.98, 1.0, 1.0)), rest.valid, rest.clipped)
    model = ReferenceModel.of(rest)
    leaning = model.detect(tilted)
    assert leaning is not None
    assert not LightDriftMonitor().update(leaning, 1)
    region = model.detect(dimmed)
    assert region is not None
    assert region.levels == pytest.approx((0.98, 1.0, 1.0), abs=1e-3)


def test_only_a_fully_untouched_field_measures_the_lights_anew() -> None:
    drift = LightDriftMonitor()
    assert drift.changes is None
    assert not drift.update(UntouchedRegion((0.95, 1.0, 1.0), 0.5, 0.001), 5)
    assert drift.changes_since(0) is None
    assert drift.update(UntouchedRegion((0.95, 1.0, 1.0), 0.99, 0.001), 7)
    assert drift.changes == pytest.approx((-0.05, 0.0, 0.0))
    assert drift.changes_since(7) is None
    assert drift.changes_since(6) == drift.changes
    drift.update_from_scan(None)
    assert drift.unseen_scans == 1
    drift.update_from_scan((1.0, 1.0, 0.99))
    assert drift.unseen_scans == 0
    assert drift.changes_since(6) is not None


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
