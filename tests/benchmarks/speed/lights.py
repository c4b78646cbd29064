"""What more lights cost: a frame of three channels, of three lights and of six to heights, in turns.

Processor time counts: the paths hardly differ, and wall time differs by more beside other programs.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, Final

import cv2
import numpy as np

from device.imaging.flat_field import LinearFrame
from host_sync.calibration.balls import PressFrame
from host_sync.calibration.calibrate import calibrate
from host_sync.calibration.frames import CalibrationFrames, calibrate_lights
from host_sync.reconstruction.pipeline import Reconstruction, reconstruct
from tests.apparatus.light_ring import lit_by_ring
from tests.apparatus.near_lamps import RADIUS_PX, SHAPE, balls, press_px
from tests.benchmarks.speed.plan import Plan, named
from tests.benchmarks.speed.timing import side_by_side

PITCH_UM: Final = 20.0
REST_SEED, SCAN_SEED = 99, 200
PATHS: Final = {"three channels": 3, "three lights": 3, "six lights": 6}
"""Lights of each path; the first is calibrated as an RGB frame is, the others as any number of lights is."""


def measure(plan: Plan, report_progress: Callable[[str], None]) -> dict[str, Any]:
    """Figures of the three paths, and whether the first two give the same heights and ± to the last bit."""
    report_progress("three lights and six")
    calibrations = {
        "three channels": calibrate(_presses(plan, 3), _rest(plan, 3), PITCH_UM),
        "three lights": calibrate_lights(CalibrationFrames(_presses(plan, 3), _rest(plan, 3), PITCH_UM)),
        "six lights": calibrate_lights(CalibrationFrames(_presses(plan, 6), _rest(plan, 6), PITCH_UM)),
    }
    frames = {name: _scan(plan, count) for name, count in PATHS.items()}

    cpu_ms: dict[str, list[float]] = {name: [] for name in PATHS}

    def path(name: str) -> Callable[[], Reconstruction]:
        def run() -> Reconstruction:
            began = time.process_time()
            result = reconstruct(frames[name], calibrations[name], name)
            cpu_ms[name].append(1e3 * (time.process_time() - began))
            return result

        return run

    methods = {name: path(name) for name in PATHS}
    figures: dict[str, Any] = side_by_side(methods, plan.rounds)
    for name in PATHS:
        figures[name]["cpu_ms"] = min(cpu_ms[name][1:])
    one, other = methods["three channels"](), methods["three lights"]()
    same = (
        one.height.z_um.tobytes() == other.height.z_um.tobytes() and one.sigma_um.tobytes() == other.sigma_um.tobytes()
    )
    return figures | {"size": named(_shape(plan)), "three_lights_identical": same}


def _shape(plan: Plan) -> tuple[int, int]:
    return SHAPE[0] * plan.lights_enlarged, SHAPE[1] * plan.lights_enlarged


def _presses(plan: Plan, lights: int) -> tuple[PressFrame, ...]:
    chosen = balls()[:: 12 // plan.presses]
    return tuple(
        PressFrame(
            f"press-{number:02d}",
            lit_by_ring(_relief(plan, press_px(ball, apex)), lights, number),
            RADIUS_PX * plan.lights_enlarged,
        )
        for number, (ball, apex) in enumerate(chosen)
    )


def _rest(plan: Plan, lights: int) -> LinearFrame:
    return lit_by_ring(np.zeros(_shape(plan)), lights, REST_SEED)


def _scan(plan: Plan, lights: int) -> LinearFrame:
    return lit_by_ring(_relief(plan, press_px(*balls()[5])), lights, SCAN_SEED)


def _relief(plan: Plan, z_px: np.ndarray) -> np.ndarray:
    """The relief seen by `lights_enlarged` times as many pixels in each direction."""
    factor = plan.lights_enlarged
    return np.asarray(cv2.resize(z_px, _shape(plan)[::-1], interpolation=cv2.INTER_CUBIC) * factor)
