"""A calibration that is an inverse map and untouched skin, and nothing else: made in a moment, for tests of video."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from device.calibration.acceptance import Coverage
from device.inverse_map.model import InverseMap
from device.surface import Float32Array
from host_sync.frame_checks.frame_model import FrameModel
from tests.apparatus.matt_light import matt_model, stated


def plain_calibration(flat_field: Float32Array, inverse: InverseMap, pitch_um: float) -> SimpleNamespace:
    """Return it: what a calibration may lack is None, and its light model explains nothing.

    flat_field : light of untouched skin, float32 array of shape (H, W, 3)
    """
    light = replace(
        matt_model(200.0, sigma=1e3), shape=flat_field.shape[:2], strengths=np.zeros((3, 3)), haze=np.ones(3)
    )
    return SimpleNamespace(
        flat_field=flat_field,
        frame_model=FrameModel.of(None, flat_field, []),
        elevation=None,
        shrinkage=None,
        viewpoint=None,
        null_colour=None,
        denoising=None,
        light=stated(light, light),
        prior_sigma=0.01,
        skin_at_rest=None,
        pitch_um=pitch_um,
        inverse=SimpleNamespace(map=inverse),
        calibration_id="c0ffee",
        preferred="direct",
        assessment=SimpleNamespace(
            passed=True, notes=(), checks=(), coverage=Coverage({"middle of the frame": False}, {}, 45.0)
        ),
        lights=None,
    )
