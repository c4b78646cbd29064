"""Readers of other authors find what was exported; none of them wrote it."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from PIL import Image

from device.surface import Float32Array
from host_sync.cli.main import main

PITCH_UM = 12.0
TOLERANCE_UM = {"gwy": 1e-12, "x3p": 1e-6, "sur": 1e-7, "sdf": 1e-12, "al3d": 1e-6}
Export = Callable[..., Path]


@pytest.mark.parametrize("form", TOLERANCE_UM)
@pytest.mark.filterwarnings("ignore")
def test_surfalize(form: str, exported: Export, z_um: Float32Array) -> None:
    surfalize = pytest.importorskip("surfalize", reason="surfalize is not installed")
    found = surfalize.Surface.load(str(exported(form)))
    assert (found.step_x, found.step_y) == pytest.approx((PITCH_UM, PITCH_UM), rel=1e-6)
    assert np.array_equal(np.isnan(found.data), np.isnan(z_um))
    assert np.nanmax(np.abs(found.data - z_um)) <= TOLERANCE_UM[form]


def test_x3pio_checks_sums_and_reads_the_record(exported: Export, z_um: Float32Array) -> None:
    x3pio = pytest.importorskip("x3pio", reason="x3pio is not installed")
    found = x3pio.read(exported("x3p"))
    assert found.header.x.increment == pytest.approx(PITCH_UM * 1e-6, rel=1e-12)
    assert found.header.y.increment == pytest.approx(PITCH_UM * 1e-6, rel=1e-12)
    z = np.asarray(found.layers[0].z)
    assert np.array_equal(np.isnan(z), np.isnan(z_um))
    assert np.nanmax(np.abs(z * 1e6 - z_um)) < 1e-6


def test_gsffile(exported: Export, z_um: Float32Array) -> None:
    gsffile = pytest.importorskip("gsffile", reason="gsffile is not installed")
    z, said = gsffile.read_gsf(str(exported("gsf")))
    assert np.array_equal(np.isnan(z), np.isnan(z_um))
    assert np.nanmax(np.abs(z * 1e6 - z_um)) < 1e-6
    assert (said["XReal"], said["YReal"]) == pytest.approx((53 * 12e-6, 37 * 12e-6))
    assert (said["XYUnits"], said["ZUnits"], said["Title"]) == ("m", "m", "part-7")


def test_gwyfile(exported: Export, z_um: Float32Array) -> None:
    gwyfile = pytest.importorskip("gwyfile", reason="gwyfile is not installed")
    held = gwyfile.load(str(exported("gwy")))
    field, mask = held["/0/data"], held["/0/mask"]
    assert np.array_equal(mask.data == 1.0, np.isnan(z_um))
    assert set(np.unique(mask.data)) == {0.0, 1.0}
    assert np.nanmax(np.abs(field.data * 1e6 - z_um)) < 1e-12
    assert held["/0/meta"]["Pixel pitch"] == "12 µm"
    assert "cal-1" in held["/0/meta"]["Origin"]


def test_float_tiff_in_opencv_and_its_resolution(exported: Export, z_um: Float32Array, sigma_um: Float32Array) -> None:
    path = exported("tiff")
    read, pages = cv2.imreadmulti(str(path), flags=cv2.IMREAD_UNCHANGED)
    assert read
    for page, field in zip(pages, (z_um, sigma_um), strict=True):
        assert np.array_equal(page, field, equal_nan=True)
    with tifffile.TiffFile(path) as tiff:
        for page in tiff.pages:
            assert page.compression == tifffile.COMPRESSION.NONE
            assert not page.is_tiled
            across, unit = page.tags["XResolution"].value, page.tags["ResolutionUnit"].value
            assert unit == tifffile.RESUNIT.CENTIMETER
            assert across[0] / across[1] == pytest.approx(1e4 / PITCH_UM)
            assert "um" in page.description


def test_png_by_its_own_text_and_by_its_sidecar(exported: Export, z_um: Float32Array) -> None:
    path = exported("png")
    grey = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert grey.dtype == np.uint16
    assert np.array_equal(grey == 0, np.isnan(z_um))
    with Image.open(path) as picture:
        said = picture.text
        assert picture.info["dpi"] == pytest.approx((25400 / PITCH_UM,) * 2, rel=1e-4)
    beside = json.loads(path.with_name("part-7.png.json").read_text())
    for scale in (said, beside):
        z = float(scale["height_at_0_um"]) + grey * float(scale["height_step_um"])
        step_um = float(scale["height_step_um"])
        assert np.abs(z - z_um)[grey > 0].max() <= 0.501 * step_um
        assert float(scale["pixel_pitch_um"]) == PITCH_UM
    assert beside["grey_of_invalid"] == 0
    assert np.nanmax(z_um) - np.nanmin(z_um) == pytest.approx(65534 * step_um, rel=1e-6)


def test_npz_holds_all_without_pickles(
    exported: Export, result: Path, z_um: Float32Array, sigma_um: Float32Array
) -> None:
    beyond = z_um > 8.0
    assert cv2.imwrite(str(result / "extrapolated.png"), beyond.astype(np.uint8) * 255)
    with np.load(exported("npz"), allow_pickle=False) as held:
        assert np.array_equal(held["z_um"], z_um, equal_nan=True)
        assert np.array_equal(held["sigma_um"], sigma_um, equal_nan=True)
        assert np.array_equal(held["valid"], np.isfinite(z_um))
        assert np.array_equal(held["extrapolated"], beyond)
        assert held["pixel_pitch_um"] == PITCH_UM
        assert str(held["name"]) == "part-7"


def test_csv_of_the_middle_row_leaves_invalid_cells_empty(
    exported: Export, z_um: Float32Array, sigma_um: Float32Array
) -> None:
    with exported("csv").open(newline="") as file:
        lines = list(csv.DictReader(file))
    assert [int(line["row"]) for line in lines] == [18] * 53
    assert [float(line["distance_um"]) for line in lines] == pytest.approx([12.0 * column for column in range(53)])
    assert [np.float32(line["height_um"]) for line in lines] == list(z_um[18])
    assert [np.float32(line["height_sigma_um"]) for line in lines] == list(sigma_um[18])


def test_csv_along_a_slanted_line_has_the_pixels_own_values(exported: Export, z_um: Float32Array) -> None:
    with exported("csv", "--line-um", "0", "0", "480", "360").open(newline="") as file:
        lines = list(csv.DictReader(file))
    assert float(lines[-1]["distance_um"]) == pytest.approx(600.0)
    assert (int(lines[-1]["column"]), int(lines[-1]["row"])) == (40, 30)
    for line in lines:
        expected = z_um[int(line["row"]), int(line["column"])]
        if np.isnan(expected):
            assert line["height_um"] == ""
        else:
            assert np.float32(line["height_um"]) == expected
    assert lines[0]["height_um"] == ""


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("form", ["x3p", "sur", "sdf", "al3d"])
def test_the_uncertainty_is_a_surface_of_its_own(
    form: str, result: Path, sigma_um: Float32Array, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    surfalize = pytest.importorskip("surfalize", reason="surfalize is not installed")
    out = tmp_path / "out"
    assert main(["export", str(result), "--to", form, "--out", str(out), "--sigma"]) == 0
    assert {path.name for path in out.iterdir()} == {f"part-7.{form}", f"part-7.sigma.{form}"}
    found = surfalize.Surface.load(str(out / f"part-7.sigma.{form}"))
    assert np.array_equal(np.isnan(found.data), np.isnan(sigma_um))
    assert np.nanmax(np.abs(found.data - sigma_um)) < 1e-6
    (result / "height_sigma_um.tif").unlink()
    assert main(["export", str(result), "--to", form, "--out", str(tmp_path / "none"), "--sigma"]) == 2
    assert "has no uncertainty to export" in capsys.readouterr().err
    assert not (tmp_path / "none").exists()
