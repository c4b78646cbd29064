"""A frame set of the twin as from a camera without mosaic: reference, twelve ball presses, a pattern."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
import tifffile
from numpy.typing import NDArray

from device.acquisition.guided_calibration import press_places
from hal.board_profile import BoardProfile
from hal.clock import VirtualClock
from hal.interfaces import PressBall
from hal.simulator.bench import build
from hal.simulator.hardware import twin_hardware
from host_sync.frames.frame_set import FrameSet, load_frame_set
from tests.benchmarks.accuracy.pattern import Patch
from tests.benchmarks.accuracy.pattern_frames import pattern_light, rgb_frame, skin_light
from tests.benchmarks.accuracy.twin_instrument import BALL_RADIUS_MM

FILE: Final = "frameset.toml"

_HEAD: Final = 'name = "twin"\npixel_pitch_um = {pitch:g}\nencoding = "linear"\n[reference]\nimage = "reference.tif"\n'
_PRESS: Final = '[[press]]\nimage = "press-{number:02d}.tif"\nball_radius_mm = {radius:g}\n'
_SCAN: Final = '[[scan]]\nname = "pattern"\nimage = "pattern.tif"\n'


def make_frame_set(profile: BoardProfile, patches: tuple[Patch, ...], folder: Path) -> FrameSet:
    """The set, its frames written to the folder; balls are not labelled, so the program finds them itself."""
    folder.mkdir(parents=True)
    bench = build(profile, VirtualClock(start_ns=5_000_000_000))
    operator = twin_hardware(bench).operator
    _write(folder / "reference.tif", rgb_frame(profile, skin_light(profile, bench.truth().z_um), 0))
    text = _HEAD.format(pitch=profile.sensor.pixel_pitch_um)
    for number, place in enumerate(press_places()):
        operator.ask(PressBall(BALL_RADIUS_MM, *place))
        light = skin_light(profile, bench.truth().z_um * np.float32(1e-3))
        _write(folder / f"press-{number:02d}.tif", rgb_frame(profile, light, 1 + number))
        text += _PRESS.format(number=number, radius=BALL_RADIUS_MM)
    _write(folder / "pattern.tif", rgb_frame(profile, pattern_light(profile, patches), 100))
    (folder / FILE).write_text(text + _SCAN, encoding="utf-8")
    return load_frame_set(folder / FILE)


def _write(path: Path, rgb: NDArray[np.uint16]) -> None:
    tifffile.imwrite(path, rgb, photometric="rgb")
