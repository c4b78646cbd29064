"""Skin at rest in quick looks: level and zero, whatever the light; steps stay; its file is read back or refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from device.bundles.calibration import CalibrationBundle
from device.errors import RecordError
from device.imaging.flat_field import LinearFrame, bin_bayer
from device.imaging.frame_light import FrameLight
from device.inverse_map.model import MODEL_FILE, read_model
from device.inverse_map.skin_at_rest import RestEvidence, SkinAtRest
from device.quick_look.solver import REST_FILE, QuickLook, QuickLookModel, levelled, quick_look, read_rest, write_rest
from device.surface import HeightMap
from hal.frame import RawFrame

CELLS = (48, 64)
SHAPE = (192, 256)


@pytest.fixture(scope="module")
def model(calibration: CalibrationBundle) -> QuickLookModel:
    inverse_map, rest = read_model(calibration.path(MODEL_FILE)), read_rest(calibration.path(REST_FILE))
    return QuickLookModel.prepare(calibration.reference(), inverse_map, calibration.record.pixel_pitch_um, rest)


def level_of(z_um: np.ndarray, kept: np.ndarray) -> np.ndarray:
    evidence = RestEvidence(kept, np.ones(kept.shape, np.bool_), FrameLight.unchanged(), 0.01)
    return levelled(HeightMap(z_um, 20.0), evidence, slope_sigma=0.01).z_um


def under(frame: LinearFrame, gains: tuple[float, float, float]) -> LinearFrame:
    return replace(frame, rgb=frame.rgb * np.float32(gains))


def flat(look: QuickLook) -> tuple[float, float]:
    """The largest of nine tenths of the heights at rest, and the median height there, both over the highest."""
    z_um = look.height.z_um
    border = np.concatenate([z_um[:20].ravel(), z_um[-20:].ravel(), z_um[:, :20].ravel(), z_um[:, -20:].ravel()])
    highest = float(z_um.max() - np.median(border))
    return float(np.percentile(np.abs(border - np.median(border)), 90)) / highest, float(np.median(border)) / highest


@pytest.mark.parametrize("gains", [(1.0, 1.0, 1.0), (1.03, 0.97, 1.0)])
def test_a_ball_stands_on_level_skin_at_zero_also_where_lights_drifted(
    press: RawFrame, model: QuickLookModel, gains: tuple[float, float, float]
) -> None:
    binned = under(bin_bayer(press, model.binning), gains)
    found, without = quick_look(binned, model), quick_look(binned, replace(model, rest=None))
    level, zero = flat(found)
    assert level < 0.02
    assert abs(zero) < 0.01
    assert flat(without)[0] > 2.0 * level
    assert abs(flat(without)[1]) > 0.05


def test_untouched_skin_is_level(calibration: CalibrationBundle, model: QuickLookModel) -> None:
    binned = under(bin_bayer(calibration.reference(), model.binning), (1.02, 1.0, 0.98))
    assert np.abs(quick_look(binned, model).height.z_um).max() < 2.0
    assert np.abs(quick_look(binned, replace(model, rest=None)).height.z_um).max() > 10.0


def test_the_two_sides_of_a_step_keep_their_distance() -> None:
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float32)
    bowl_um = 0.004 * ((row - 96.0) ** 2 + (column - 128.0) ** 2)
    step_um = np.float32(150.0) * np.clip((column - 120.0) / 16.0, 0.0, 1.0)
    kept = np.zeros(CELLS, np.float32)
    kept[:, 28:36] = 1.0
    z_um = level_of((step_um + 0.05 * bowl_um).astype(np.float32), kept)
    lower, upper = z_um[:, :104], z_um[:, 152:]
    assert np.percentile(np.abs(lower - np.median(lower)), 95) < 0.3
    assert np.median(upper) - np.median(lower) == pytest.approx(150.0, abs=1.0)


def test_what_skin_at_rest_shows_is_taken_off_the_object_smoothly() -> None:
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float32)
    away = np.hypot(row - 96.0, column - 128.0)
    ball_um = np.maximum(300.0 - 0.2 * away**2, 0.0).astype(np.float32)
    bowl_um = (40.0 + 0.3 * column + 0.1 * row).astype(np.float32)
    cells_away = np.hypot(*(np.mgrid[: CELLS[0], : CELLS[1]] * 4.0 + 1.5 - np.array([96.0, 128.0])[:, None, None]))
    z_um = level_of(ball_um + bowl_um, (cells_away < 44.0).astype(np.float32))
    assert np.abs(z_um[away > 60.0]).max() < 3.0
    assert np.abs(z_um - ball_um).max() < 12.0


def test_the_noise_of_untouched_skin_is_read_back_bit_for_bit(calibration: CalibrationBundle, tmp_path: Path) -> None:
    noise = read_rest(calibration.path(REST_FILE))
    write_rest(tmp_path / REST_FILE, noise)
    again = read_rest(tmp_path / REST_FILE)
    for name in ("covariance", "pooled", "roughness", "darkness"):
        assert np.array_equal(getattr(again, name), getattr(noise, name))
    assert (again.gain_sigma, again.offset_sigma) == (noise.gain_sigma, noise.offset_sigma)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"covariance": np.zeros((3, 4, 3, 3), np.float32)}, "wrong shapes"),
        ({"roughness": np.ones((2, 2, 3), np.float32)}, "wrong shapes"),
        ({"gain_sigma": -1.0}, "no variances"),
        ({"darkness": float("nan")}, "no variances"),
        ({"pooled": -1.0}, "no covariances"),
    ],
)
def test_a_file_with_other_contents_is_refused_by_name(
    calibration: CalibrationBundle, tmp_path: Path, change: dict[str, object], why: str
) -> None:
    noise = read_rest(calibration.path(REST_FILE))
    ((name, value),) = change.items()
    if isinstance(value, float) and name != "gain_sigma":
        value = value * np.ones_like(getattr(noise, name))
    path = tmp_path / REST_FILE
    write_rest(path, replace(noise, **{name: value}))
    with pytest.raises(RecordError, match=f"{REST_FILE}: holds .*{why}"):
        read_rest(path)


def test_a_damaged_file_is_refused_by_name(calibration: CalibrationBundle, tmp_path: Path) -> None:
    path = tmp_path / REST_FILE
    path.write_bytes(calibration.path(REST_FILE).read_bytes()[:-100])
    with pytest.raises(RecordError, match=f"{REST_FILE}: holds no readable model"):
        read_rest(path)


def test_a_calibration_measures_the_noise_on_its_presses(calibration: CalibrationBundle) -> None:
    noise = read_rest(calibration.path(REST_FILE))
    assert isinstance(noise, SkinAtRest)
    assert 0.0003 <= noise.noise < 0.02
    assert calibration.record.model_files == (MODEL_FILE, REST_FILE)
