"""A result against another map of the same pixels."""

from pathlib import Path

import numpy as np
import pytest

from device.surface import HeightMap
from host_sync.cli.main import main
from host_sync.errors import MeasurementError
from host_sync.measurement.foreign_file import map_difference
from tests.benchmarks.accuracy.real_sets import data_folder

ROW, COLUMN = np.mgrid[:60, :80].astype(np.float32)
GROOVE = np.where(np.abs(COLUMN - 40.0) < 10.0, -100.0, 0.0).astype(np.float32)
MAKERS = data_folder() / "groove" / "heightmap.tmd"


def test_a_tilt_and_an_offset_are_no_difference() -> None:
    found = map_difference(HeightMap(GROOVE + 3.0 * ROW - COLUMN + 50.0, 10.0), HeightMap(GROOVE, 10.0))
    assert found.rms_um < 1e-3
    assert found.depth_um == pytest.approx(100.0, abs=5.0)
    assert found.compared == 1.0


def test_what_differs_is_reported_in_percent_of_the_depth() -> None:
    wave = 2.0 * np.sin(2.0 * np.pi * ROW / 6.0).astype(np.float32)
    one = GROOVE + wave
    one[:6] = np.nan
    found = map_difference(HeightMap(one, 10.0), HeightMap(GROOVE, 10.0))
    assert found.rms_um == pytest.approx(2.0 / np.sqrt(2.0), rel=0.02)
    assert found.percent_of_depth == pytest.approx(100.0 * found.rms_um / found.depth_um)
    assert found.compared == pytest.approx(0.9)


@pytest.mark.parametrize(
    ("z_um", "pitch_um", "complaint"),
    [
        (GROOVE[:, :70], 10.0, "70x60 and 80x60 pixels"),
        (GROOVE, 11.0, "pixels of 11 and 10 µm"),
        (np.full_like(GROOVE, np.nan), 10.0, "hardly a valid pixel"),
    ],
)
def test_maps_of_other_pixels_are_refused(z_um: np.ndarray, pitch_um: float, complaint: str) -> None:
    with pytest.raises(MeasurementError, match=complaint):
        map_difference(HeightMap(z_um, pitch_um), HeightMap(GROOVE, 10.0))


@pytest.mark.skipif(not MAKERS.is_file(), reason=f"no groove in {MAKERS.parent}: set RETROGRAPH_DATA")
def test_the_command_reads_the_makers_file(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert main(["compare", str(MAKERS), str(MAKERS)]) == 0
    told = capsys.readouterr().out
    assert "0.00 % of the depth of 4" in told
    assert "over 100% of the pixels" in told or "over 99% of the pixels" in told
    assert main(["compare", str(tmp_path), str(MAKERS)]) == 2
