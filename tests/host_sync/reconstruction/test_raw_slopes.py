"""The calibration's null colour makes raw slopes quieter, leaves shrunk ones alone, and belongs to its id."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import msgspec
import numpy as np
import pytest
from near_lamps import RADIUS_PX, SHAPE, press_px

from device.balls.sphere import Ball, BallSamples, Viewpoint
from device.imaging.flat_field import LinearFrame, flat_field_correct
from host_sync.calibration.calibrate import Calibration, identified
from host_sync.denoising.bounded_shrinkage import shrinkage_of
from host_sync.denoising.frame_noise import FrameNoise, learn_null_colour
from host_sync.reconstruction.pipeline import Reconstruction, reconstruct
from tests.apparatus.light_ring import lit_by_ring

BALL = Ball(170.0, 120.0, 28.0, RADIUS_PX)
QUIET, LOUD = 0.003, 0.012
"""Noise of light: of two channels, and of the third."""

FINEST_VARIANCE = 0.8
"""Variance of the finest detail as a share of white noise's."""


def noise_of(loud: int) -> np.ndarray:
    """Noise by channel, of which one is loud."""
    return np.where(np.arange(3) == loud, LOUD, QUIET)


def noisy(frame: LinearFrame, noise: np.ndarray, seed: int = 501) -> LinearFrame:
    light = frame.rgb + noise * np.random.default_rng(seed).standard_normal(frame.rgb.shape)
    return LinearFrame(np.clip(light, 0.0, 1.0).astype(np.float32), frame.clipped)


def pressed() -> LinearFrame:
    return lit_by_ring(press_px(BALL, 15.0), 3, 0, noise=0.0)


def bumpy_samples(calibration: Calibration) -> BallSamples:
    """Colours and slopes of bumps all over the field, without noise."""
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float32)
    z_px = 6.0 * np.sin(row / 9.0) * np.cos(column / 11.0)
    image = flat_field_correct(lit_by_ring(z_px, 3, 0, noise=0.0), calibration.flat_field)
    q, p = np.gradient(z_px)
    p, q, column, row = (part.ravel()[::7].astype(np.float32) for part in (p, q, column, row))
    return BallSamples(image.values.reshape(-1, 3)[::7], p, q, column, row, np.zeros(len(p), np.intp))


def that_knows_noise(calibration: Calibration, noise: np.ndarray) -> Calibration:
    """The calibration, whose map was taught with even noise, as of frames with noise by channel."""
    assert calibration.denoising is not None
    root = 0.5 * noise / calibration.flat_field.mean(axis=(0, 1))
    known = FrameNoise(FINEST_VARIANCE * np.diag(root**2), np.array([1.0, 0.116, 0.0226]))
    null_colour = learn_null_colour(bumpy_samples(calibration), calibration.inverse.map, known)
    assert null_colour is not None
    shrinkage = replace(calibration.denoising.shrinkage, noise=known, shrinkage=shrinkage_of(known, 1.0))
    return replace(calibration, denoising=replace(calibration.denoising, shrinkage=shrinkage, null_colour=null_colour))


def without_null_colour(calibration: Calibration) -> Calibration:
    """The calibration, none of whose colours is free of slopes."""
    assert calibration.denoising is not None
    return replace(calibration, denoising=replace(calibration.denoising, null_colour=None))


def louder(found: Reconstruction, silent: Reconstruction) -> tuple[float, float]:
    """Root mean square noise of slopes as read, and of the surface's slopes."""
    by_place = [
        [getattr(one, axis) - getattr(other, axis) for axis in "pq"]
        for one, other in ((found.gradients, silent.gradients), (found, silent))
    ]
    read, surface = (float(np.sqrt(np.mean(np.square(part)))) for part in by_place)
    return read, surface


@pytest.mark.slow
@pytest.mark.parametrize("loud", [0, 1, 2])
def test_raw_slopes_are_quieter_with_the_null_colour(ring_calibration: Calibration, loud: int) -> None:
    noise = noise_of(loud)
    calibration = that_knows_noise(ring_calibration, noise)
    without = without_null_colour(calibration)
    silent = reconstruct(pressed(), without, "silent", detail="raw")
    better, plain = (reconstruct(noisy(pressed(), noise), one, "ball", detail="raw") for one in (calibration, without))
    for less, more in zip(louder(better, silent), louder(plain, silent), strict=True):
        assert less < 0.9 * more
    for axis in "pq":
        assert abs(float((getattr(better.gradients, axis) - getattr(plain.gradients, axis)).mean())) < 1e-3


@pytest.mark.slow
def test_shrunk_detail_does_not_change(ring_calibration: Calibration) -> None:
    noise = noise_of(0)
    calibration = that_knows_noise(ring_calibration, noise)
    frame = noisy(pressed(), noise)
    found, without = (reconstruct(frame, one, "ball") for one in (calibration, without_null_colour(calibration)))
    for name in ("p", "q", "sigma_um", "samples_um"):
        np.testing.assert_array_equal(getattr(found, name), getattr(without, name))
    np.testing.assert_array_equal(found.height.z_um, without.height.z_um)
    assert found.other is not None
    assert without.other is not None
    assert np.abs(found.other.z_um - without.other.z_um).max() > 0.1


def test_the_id_of_a_calibration_follows_from_every_member(ring_calibration: Calibration) -> None:
    assert identified(ring_calibration).calibration_id == ring_calibration.calibration_id
    denoising, light = ring_calibration.denoising, ring_calibration.light
    assert denoising is not None
    assert denoising.null_colour is not None
    limit = 0.5 * denoising.null_colour.limit
    others: list[dict[str, Any]] = [
        {"flat_field": np.float32(1.01) * ring_calibration.flat_field},
        {"has_reference": False},
        {"pitch_um": 1.01 * ring_calibration.pitch_um},
        {"presses": ring_calibration.presses[1:]},
        {"held_out_deg": {"direct": 0.1}},
        {"light": replace(light, confirmed=0.5 * light.confirmed)},
        {"elevation": msgspec.structs.replace(ring_calibration.elevation, apex_px=1.0)},
        {"denoising": None},
        {"denoising": replace(denoising, null_colour=None)},
        {"denoising": replace(denoising, null_colour=replace(denoising.null_colour, limit=limit))},
        {"viewpoint": Viewpoint(100.0, 80.0, 9000.0)},
        {"skin_at_rest": None},
    ]
    ids = [identified(replace(ring_calibration, **other)).calibration_id for other in others]
    assert len({ring_calibration.calibration_id, *ids}) == len(ids) + 1
