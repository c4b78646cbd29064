"""Ambient light is taken out by a frame that was taken nearly alike, and by no other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from device.errors import FrameError
from device.imaging.frame_light import without_ambient
from hal.frame import CameraSettings, RawFrame


@pytest.fixture
def frame(raw_frame: Callable[..., RawFrame]) -> RawFrame:
    dim = raw_frame()
    return replace(dim, mosaic=np.minimum(dim.mosaic, 2000).astype(np.uint16))


def test_a_microsecond_of_difference_is_none(frame: RawFrame) -> None:
    granted = frame.granted
    near = CameraSettings(granted.exposure_us + 1.0, granted.analogue_gain * 1.0005)
    dark = replace(frame, mosaic=np.full_like(frame.mosaic, frame.black_level_dn), granted=near)
    np.testing.assert_array_equal(without_ambient(frame, dark).mosaic, frame.mosaic)


@pytest.mark.parametrize(("longer", "louder"), [(1.05, 1.0), (1.0, 1.05)])
def test_other_settings_are_refused(frame: RawFrame, longer: float, louder: float) -> None:
    granted = frame.granted
    other = CameraSettings(granted.exposure_us * longer, granted.analogue_gain * louder)
    with pytest.raises(FrameError, match="was not taken as the scan was"):
        without_ambient(frame, replace(frame, granted=other))
