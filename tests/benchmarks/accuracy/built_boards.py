"""Resolution of the shipped boards as they would be built: the lens and beam of the profile, and balanced light.

Every board calibrates with the ball of the bill of materials, after `--auto-exposure`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec

from device.acquisition.auto_exposure import auto_exposure
from hal.board_profile import BoardProfile, load_board_profile
from hal.clock import VirtualClock
from hal.simulator.bench import build
from hal.simulator.hardware import twin_hardware
from hal.simulator.scene import twin_of
from tests.benchmarks.accuracy.marks import BUILT
from tests.benchmarks.accuracy.resolution import mosaic_resolution
from tests.benchmarks.accuracy.twin_instrument import BALL_RADIUS_MM, TwinInstrument


def built_figures(folder: Path, report_progress: Callable[[str], None]) -> Iterator[tuple[str, float]]:
    """Figures of the resolution through each board's own mosaic and lens, in its own pixels."""
    for name in BUILT:
        report_progress(f"{name}: calibration as built")
        instrument = TwinInstrument(balanced(twin_of(load_board_profile(name))), folder / name)
        report_progress(f"{name}: resolution")
        resolution = mosaic_resolution(instrument)
        yield f"{name}: ridge of 1 px, width", resolution.widest_px
        yield f"{name}: sinusoid of 8 px keeps", resolution.least_kept(8.0)


def balanced(profile: BoardProfile) -> BoardProfile:
    """A twin's profile with the exposure and currents that auto-exposure finds for it."""
    hardware = twin_hardware(build(profile, VirtualClock(start_ns=5_000_000_000, wall_start_s=1_000.0)))
    with hardware:
        plan = auto_exposure(hardware, BALL_RADIUS_MM, lambda _: None).plan
    lights = tuple(msgspec.structs.replace(light, current_ma=plan.currents_ma[light.name]) for light in profile.lights)
    camera = msgspec.structs.replace(
        profile.camera, exposure_us=plan.settings.exposure_us, analogue_gain=plan.settings.analogue_gain
    )
    return msgspec.structs.replace(profile, lights=lights, camera=camera)
