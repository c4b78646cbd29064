"""The quick look: binned and tabulated, yet the same surface as the full evaluation of the same scan."""

import numpy as np
import pytest

from device.bundles.calibration import CalibrationBundle
from device.errors import CalibrationMismatch
from device.imaging.flat_field import bin_bayer, demosaic, flat_field_correct, make_flat_field
from device.inverse_map.model import InverseMap, read_model
from device.quick_look.solver import QuickLookModel, quick_look, quick_look_binning
from device.surface import integrate_dct
from hal.frame import RawFrame


@pytest.fixture(scope="module")
def inverse_map(calibration: CalibrationBundle) -> InverseMap:
    return read_model(calibration.path(calibration.record.model_files[0]))


@pytest.fixture(scope="module")
def model(calibration: CalibrationBundle, inverse_map: InverseMap) -> QuickLookModel:
    return QuickLookModel.prepare(calibration.reference(), inverse_map, calibration.record.pixel_pitch_um)


def test_quick_look_and_full_evaluation_of_one_scan_agree(
    calibration: CalibrationBundle, inverse_map: InverseMap, press: RawFrame, model: QuickLookModel
) -> None:
    look = quick_look(bin_bayer(press, model.binning), model)
    flat_field = make_flat_field(demosaic(calibration.reference()))
    full = inverse_map.gradients(flat_field_correct(demosaic(press), flat_field))
    z_um = integrate_dct(full.p, full.q, calibration.record.pixel_pitch_um)
    rows, columns = look.height.z_um.shape
    binned_um = z_um.reshape(rows, model.binning, columns, model.binning).mean(axis=(1, 3))
    difference_um = look.height.z_um - binned_um
    assert np.ptp(binned_um) > 200.0
    assert difference_um.std() < 0.01 * np.ptp(binned_um)


def test_the_pitch_grows_with_the_bin(press: RawFrame, model: QuickLookModel) -> None:
    look = quick_look(bin_bayer(press, model.binning), model)
    assert look.height.pitch_um == model.binning * model.pitch_um
    assert look.height.z_um.dtype == np.float32


def test_a_frame_of_another_size_is_refused(press: RawFrame, model: QuickLookModel) -> None:
    with pytest.raises(CalibrationMismatch, match="frames of one camera mode"):
        quick_look(bin_bayer(press, 2 * model.binning), model)


@pytest.mark.parametrize(("columns", "binning"), [(364, 2), (1024, 2), (1026, 4), (1456, 4), (2028, 4), (4056, 8)])
def test_the_smallest_even_binning_that_fits_the_screen(columns: int, binning: int) -> None:
    assert quick_look_binning((3 * columns // 4, columns)) == binning
