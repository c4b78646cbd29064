"""Recorded frames of a real sensor through the driver, as its camera would send them; skipped where there are none."""

import os
from pathlib import Path

import cv2
import numpy as np
import pytest
from fake_v4l2 import FakeVideo, encoded, uvc_profile

from hal.drivers.usb_hardware import usb_hardware
from hal.drivers.v4l2_stack import StreamFormat
from hal.frame import RawFrame
from hal.hardware import Hardware
from hal.interfaces import Clock
from hal.simulator.bench import SimulatedScene

DATA = Path(os.environ.get("RETROGRAPH_DATA", Path(__file__).parents[4] / "shared" / "data"))
FRAMES = sorted((DATA / "taxim-small").glob("*.png"))
ROWS, COLUMNS = 272, 364

pytestmark = pytest.mark.skipif(not FRAMES, reason=f"no recorded frames in {DATA}: set RETROGRAPH_DATA")


def recorded() -> list[np.ndarray]:
    pictures = [cv2.imread(str(path), cv2.IMREAD_COLOR) for path in FRAMES[:8]]
    return [cv2.resize(picture, (COLUMNS, ROWS), interpolation=cv2.INTER_CUBIC) for picture in pictures]


def playing(bench: SimulatedScene, pictures: list[np.ndarray]) -> Hardware:
    """A sensor on USB whose camera sends these pictures, one after another, once it has settled."""
    profile = uvc_profile(bench.profile)
    assert profile.uvc
    shown = iter([*pictures[:1] * (profile.uvc.settle_frames - 1), *pictures])

    def coded(_frame: RawFrame, stream: StreamFormat) -> bytes:
        return encoded(next(shown), stream)

    clock: Clock = bench.clock
    return usb_hardware(profile, clock, FakeVideo(bench, coded=coded))


def test_what_the_driver_hands_out_is_the_recorded_light(bench: SimulatedScene) -> None:
    pictures = recorded()
    with playing(bench, pictures) as hardware:
        frames = [hardware.camera.next_frame(1.0) for _ in pictures]
    for picture, frame in zip(pictures, frames, strict=True):
        stored = picture.astype(float) / 255.0
        light = np.where(stored <= 0.04045, stored / 12.92, ((stored + 0.055) / 1.055) ** 2.4)
        for colour, site in ((2, (0, 0)), (0, (1, 1))):
            seen = frame.mosaic[site[0] :: 2, site[1] :: 2] / frame.white_level_dn
            unsaturated = seen < 0.9
            off = (seen - light[site[0] :: 2, site[1] :: 2, colour])[unsaturated]
            assert np.sqrt(np.mean(off**2)) < 0.02  # JPEG halves the resolution of colours
            assert abs(float(off.mean())) < 0.003
    assert len({frame.mosaic.tobytes() for frame in frames}) == len(frames)
