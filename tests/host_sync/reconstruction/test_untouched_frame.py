"""A frame of untouched skin becomes a flat height map, and says that it shows no more than noise."""

from __future__ import annotations

import numpy as np
import pytest
from near_lamps import RADIUS_PX, SHAPE, balls, press_px

from host_sync.calibration.balls import PressFrame
from host_sync.calibration.calibrate import Calibration, calibrate
from host_sync.reconstruction import pipeline
from host_sync.reconstruction.pipeline import Reconstruction, reconstruct
from tests.apparatus.light_ring import lit_by_ring

PITCH_UM = 20.0


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    presses = [
        PressFrame(f"press-{number:02d}", lit_by_ring(press_px(*ball), 3, number), RADIUS_PX)
        for number, ball in enumerate(balls())
    ]
    return calibrate(presses, lit_by_ring(np.zeros(SHAPE), 3, 99), PITCH_UM)


def wave_checks(found: Reconstruction) -> list[float | None]:
    return [check.value for check in found.frame_checks if check.name == "noise waves"]


def test_untouched_skin_is_flat_and_says_so(calibration: Calibration, monkeypatch: pytest.MonkeyPatch) -> None:
    frame = lit_by_ring(np.zeros(SHAPE), 3, 501)
    found = reconstruct(frame, calibration, "nothing")
    monkeypatch.setattr(pipeline, "noise_waves", lambda *_: None)
    before = reconstruct(frame, calibration, "nothing")
    flat_um, before_um = (float(np.sqrt((one.height.z_um**2).mean())) for one in (found, before))
    assert flat_um < 0.5 * before_um
    assert wave_checks(found) == [pytest.approx(4.0, abs=2.0)]
    assert not wave_checks(before)
    assert flat_um / float(found.sigma_um.mean()) < 1.3
    assert found.sigma_um.mean() < before.sigma_um.mean()


def test_a_ball_is_left_as_it_was(calibration: Calibration, monkeypatch: pytest.MonkeyPatch) -> None:
    frame = lit_by_ring(press_px(*balls()[5]), 3, 501)
    found = reconstruct(frame, calibration, "ball")
    monkeypatch.setattr(pipeline, "noise_waves", lambda *_: None)
    before = reconstruct(frame, calibration, "ball")
    assert np.array_equal(found.height.z_um, before.height.z_um)
    assert not wave_checks(found)


def test_noise_is_kept_where_that_is_asked(calibration: Calibration) -> None:
    frame = lit_by_ring(np.zeros(SHAPE), 3, 501)
    kept, without = (reconstruct(frame, calibration, "nothing", keep_noise=keep) for keep in (True, False))
    assert not wave_checks(kept)
    assert float(kept.height.z_um.std()) > 2.0 * float(without.height.z_um.std())
