"""A frame's evidence of skin at rest is the same from tables that are kept as from the calibration's own."""

from __future__ import annotations

import numpy as np
import pytest

from device.errors import CalibrationMismatch
from device.imaging.flat_field import NormalizedImage
from device.inverse_map.skin_at_rest import SkinAtRest
from host_sync.frames.sequence import StoredFrame
from host_sync.video.coarse import FrameLight
from host_sync.video.frame_rest import FrameRest
from host_sync.video.frame_solver import FrameSolver
from tests.host_sync.video.test_reconstruct import REST, SHAPE, calibration

GAIN_SIGMA = 0.06


def skin_at_rest(gain_sigma: float = GAIN_SIGMA) -> SkinAtRest:
    """Skin whose light differs by a percent from cell to cell, and in whose corner the reference is black."""
    size = 48, 64
    random = np.random.default_rng(3)
    mixed = random.normal(0.0, 0.01, (*size, 3, 3))
    covariance = (mixed @ np.swapaxes(mixed, -1, -2) + 1e-4 * np.eye(3)).astype(np.float32)
    darkness = random.uniform(1.5, 4.0, (*size, 3)).astype(np.float32)
    darkness[:5, :5] = 1e4
    roughness = np.full((*size, 3), 1e-4, np.float32)
    return SkinAtRest(covariance, 0.3 * covariance, roughness, darkness, gain_sigma, 0.002)


def test_kept_tables_give_the_evidence_of_the_calibration() -> None:
    known = skin_at_rest()
    values = np.random.default_rng(4).normal(1.02, 0.01, (240, 320, 3)).astype(np.float32)
    values[80:160, 100:200] *= 1.4
    every = np.ones(values.shape[:2], np.bool_)
    image = NormalizedImage(values, every, ~every)
    wanted, found = known.evidence(image), FrameRest.like(known).evidence(image)
    assert 0.015 < wanted.gains.mean() < 0.03
    assert 0.3 < (wanted.kept < 0.1).mean() < 0.95
    np.testing.assert_allclose(found.gains, wanted.gains, atol=1e-9)
    np.testing.assert_allclose(found.offsets, wanted.offsets, atol=1e-9)
    np.testing.assert_allclose(found.kept, wanted.kept, atol=1e-5)
    np.testing.assert_array_equal(found.lit, wanted.lit)
    assert found.gain_sigma == wanted.gain_sigma


def test_a_frame_may_be_as_bright_as_the_calibrations_own_presses_are() -> None:
    """Untouched skin 18 % too bright is refused, unless presses of the calibration differ by so much as well."""
    bright = StoredFrame("bright.png", np.full((*SHAPE, 3), round(1.18 * REST * 65535.0), np.uint16))
    bright.pixels[50:70, 70:90, 0] = round(1.4 * REST * 65535.0)
    known, light = calibration(), FrameLight(np.ones(3, np.float32), np.zeros(3, np.float32))
    known.skin_at_rest = skin_at_rest()
    out = np.empty(SHAPE, np.float32)
    assert not FrameSolver(known, "direct", "linear").solve(bright, out, light).is_relative
    known.skin_at_rest = skin_at_rest(0.005)
    with pytest.raises(CalibrationMismatch, match=r"untouched skin is 18% brighter in (red|green|blue)"):
        FrameSolver(known, "direct", "linear").solve(bright, out, light)
