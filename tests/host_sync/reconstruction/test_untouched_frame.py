"""A frame of untouched skin becomes a flat height map with a zero, and an object on it keeps its heights."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from near_lamps import SHAPE, balls, press_px

from host_sync.calibration.calibrate import Calibration
from host_sync.reconstruction.pipeline import Reconstruction, reconstruct
from host_sync.reconstruction.result_writer import relief_words
from tests.apparatus.light_ring import lit_by_ring


def resting(found: Reconstruction) -> list[float | None]:
    return [check.value for check in found.frame_checks if check.name == "skin at rest"]


def test_untouched_skin_is_flat_and_has_a_zero(ring_calibration: Calibration) -> None:
    frame = lit_by_ring(np.zeros(SHAPE), 3, 501)
    found = reconstruct(frame, ring_calibration, "nothing")
    flat_um = float(np.sqrt((found.height.z_um**2).mean()))
    assert not found.datum.is_relative
    assert resting(found) == [pytest.approx(1.0, abs=0.1)]
    assert flat_um < 0.3
    assert flat_um / float(found.sigma_um.mean()) < 1.3


def test_a_ball_stands_on_flat_skin(ring_calibration: Calibration) -> None:
    press = press_px(*balls()[5])
    found = reconstruct(lit_by_ring(press, 3, 501), ring_calibration, "ball")
    truth_um = press * ring_calibration.pitch_um
    free = truth_um < 0.2
    assert not found.datum.is_relative
    assert np.percentile(np.abs(found.height.z_um[free]), 95) < 0.01 * truth_um.max()
    assert abs(found.height.z_um.max() / truth_um.max() - 1.0) < 0.02
    stated_um = float(relief_words(found).partition("± ")[2].partition(" µm")[0])
    assert stated_um == pytest.approx(float(np.median(found.sigma_um[found.datum.skin])), rel=0.05)
    assert stated_um > np.abs(found.height.z_um[found.datum.skin]).mean()


@pytest.mark.parametrize(
    ("figure", "sentence"),
    [
        ("levels_apart_um", "untouched skin lies 73 µm apart in height"),
        ("pit_um", "skin lies 73 µm below untouched skin"),
    ],
)
def test_skin_at_impossible_heights_is_a_doubt_of_the_result(
    figure: str, sentence: str, ring_calibration: Calibration, monkeypatch: pytest.MonkeyPatch
) -> None:
    frame = lit_by_ring(press_px(*balls()[5]), 3, 501)
    assert reconstruct(frame, ring_calibration, "ball").warnings == ()
    monkeypatch.setattr(f"host_sync.reconstruction.heights.{figure}", lambda *_: 73.2)
    (doubt,) = reconstruct(frame, ring_calibration, "ball").warnings
    assert doubt.startswith(sentence)


def test_untouched_skin_is_not_extrapolated_wherever_the_balls_were(ring_calibration: Calibration) -> None:
    inverse_map = ring_calibration.inverse.map
    assert inverse_map.leverage is not None
    few = replace(inverse_map, leverage=replace(inverse_map.leverage, trained=1e-9))
    calibration = replace(ring_calibration, inverse=replace(ring_calibration.inverse, map=few))
    found = reconstruct(lit_by_ring(press_px(*balls()[5]), 3, 501), calibration, "ball")
    assert 0.1 < found.datum.skin.mean() < 0.9
    assert np.array_equal(found.extrapolated, ~found.datum.skin)


def test_noise_is_kept_where_that_is_asked(ring_calibration: Calibration) -> None:
    frame = lit_by_ring(np.zeros(SHAPE), 3, 501)
    kept, without = (reconstruct(frame, ring_calibration, "nothing", keep_noise=keep) for keep in (True, False))
    assert not resting(kept)
    assert float(kept.height.z_um.std()) > 2.0 * float(without.height.z_um.std())
