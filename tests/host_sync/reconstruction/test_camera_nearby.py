"""A ball on the twin, whose camera stands 160 mm over the skin: read by what knows that, and by what does not."""

from dataclasses import replace

import numpy as np
import pytest

from device.acquisition.capture import CaptureSettings, capture
from device.bundles.calibration import CalibrationBundle
from device.errors import CalibrationError
from device.imaging.flat_field import demosaic
from hal.hardware import Hardware
from hal.interfaces import PressBall
from hal.simulator.bench import SimulatedScene
from host_sync.calibration.frames import calibrate_frames
from host_sync.calibration_file.calibrator import Calibrator
from host_sync.calibration_file.inputs import frames_of_bundle
from host_sync.reconstruction.pipeline import reconstruct
from host_sync.reconstruction.result_writer import result_record

RADIUS_MM = 3.0
GENTLE, STEEP = 0.1, 0.5


@pytest.mark.parametrize(
    ("knows", "least", "most"), [(True, -0.005, 0.008), pytest.param(False, 0.008, 0.02, marks=pytest.mark.slow)]
)
def test_slopes_of_a_raised_ball(
    knows: bool,
    least: float,
    most: float,
    twin_bundle: CalibrationBundle,
    calibrator: Calibrator,
    hardware: Hardware,
    bench: SimulatedScene,
) -> None:
    frames = frames_of_bundle(twin_bundle)
    assert frames.pupil_height_mm == 160.0
    if knows:
        calibration = calibrator.of_bundle(twin_bundle).calibration
    else:
        calibration = calibrate_frames(replace(frames, pupil_height_mm=None))
    assert (calibration.viewpoint is not None) == knows
    with hardware:
        hardware.operator.ask(PressBall(RADIUS_MM, 0.25, 0.33))
        hardware.button.wait_for_press(None)
        frame = capture(hardware, CaptureSettings.of_board(hardware))
    truth = bench.truth()
    stated_mm = 160.0 if knows else None
    found = reconstruct(demosaic(frame), calibration, "ball")
    assert result_record("ball", found, calibration).pupil_height_mm == pytest.approx(stated_mm)
    slope = np.hypot(truth.p, truth.q)
    here = truth.contact & (slope > GENTLE) & (slope < STEEP)
    along = (found.p - truth.p) * truth.p + (found.q - truth.q) * truth.q
    assert least < along[here].sum() / (slope[here] ** 2).sum() < most


def test_a_camera_hardly_higher_than_the_balls_is_refused(twin_bundle: CalibrationBundle) -> None:
    frames = frames_of_bundle(twin_bundle)
    with pytest.raises(CalibrationError, match="check pupil_height_mm"):
        calibrate_frames(replace(frames, pupil_height_mm=0.16))
