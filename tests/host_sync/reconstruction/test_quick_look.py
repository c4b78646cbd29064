"""The handheld's quick look and the workstation's height map of one scan agree in their zero and in their heights."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from device.bundles.calibration import CalibrationBundle
from device.imaging.flat_field import bin_bayer
from device.inverse_map.model import MODEL_FILE, read_model
from device.quick_look.solver import REST_FILE, QuickLookModel, quick_look, read_rest
from host_sync.calibration_file.calibrator import Calibrator
from host_sync.reconstruction.pipeline import reconstruct


@pytest.mark.parametrize("number", [2, 5])
def test_zero_and_top_agree(calibrator: Calibrator, twin_bundle: CalibrationBundle, number: int) -> None:
    frame = twin_bundle.press_frame(twin_bundle.record.presses[number])
    inverse_map, rest = read_model(twin_bundle.path(MODEL_FILE)), read_rest(twin_bundle.path(REST_FILE))
    model = QuickLookModel.prepare(twin_bundle.reference(), inverse_map, twin_bundle.record.pixel_pitch_um, rest)
    look_um = quick_look(bin_bayer(frame, model.binning), model).height.z_um
    whole = reconstruct(frame, calibrator.of_bundle(twin_bundle).calibration, "press")
    assert not whole.datum.is_relative
    size = look_um.shape[::-1]
    whole_um = cv2.resize(whole.height.z_um, size, interpolation=cv2.INTER_AREA)
    skin = cv2.resize(whole.datum.skin.astype(np.float32), size, interpolation=cv2.INTER_AREA) == 1.0
    top_um = float(np.nanmax(whole_um))
    assert top_um > 200.0
    assert abs(float(np.median((look_um - whole_um)[skin]))) < 0.005 * top_um
    assert np.percentile(np.abs(look_um - whole_um)[skin], 95) < 0.01 * top_um
    assert float(look_um.max()) == pytest.approx(top_um, rel=0.04)
