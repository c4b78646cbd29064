"""A calibration that is an inverse map and untouched skin, and nothing else: made in a moment, for tests of video."""

from __future__ import annotations

from types import SimpleNamespace

from device.inverse_map.model import InverseMap
from device.surface.fields import Float32Array
from host_sync.frame_checks.frame_model import FrameModel


def plain_calibration(flat_field: Float32Array, inverse: InverseMap, pitch_um: float) -> SimpleNamespace:
    """Return it: what a calibration may lack is None.

    flat_field : light of untouched skin, float32 array of shape (H, W, 3)
    """
    return SimpleNamespace(
        flat_field=flat_field,
        frame_model=FrameModel.of(None, flat_field, []),
        elevation=None,
        shrinkage=None,
        viewpoint=None,
        null_colour=None,
        fitted_lamps=None,
        shading=None,
        lamps=None,
        quadric=None,
        press_levels=None,
        skin_at_rest=None,
        pitch_um=pitch_um,
        inverse=SimpleNamespace(map=inverse),
        calibration_id="c0ffee",
        preferred="direct",
        assessment=SimpleNamespace(
            passed=True, notes=(), checks=(), coverage=SimpleNamespace(sectors={"middle of the frame": False})
        ),
        lights=None,
    )
