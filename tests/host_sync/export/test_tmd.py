"""GelSight's TMD, version 2: written to its documented layout, and read as GelSight writes it."""

from __future__ import annotations

import os
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from device.surface import Float32Array
from host_sync.cli.main import main
from host_sync.errors import ExportError
from host_sync.export.array_formats import read_tmd, write_tmd
from host_sync.export.source_surface import SourceSurface
from host_sync.export.surface_export import ExportChoices, export_surface

DATA = Path(os.environ.get("RETROGRAPH_DATA", Path(__file__).parents[4] / "shared" / "data"))
MAGIC = b"Binary TrueMap Data File v2.0\r\n\0"


def test_the_layout_is_the_documented_one_in_mm(exported: Callable[..., Path], z_um: Float32Array) -> None:
    data = exported("tmd").read_bytes()
    assert len(MAGIC) == 32
    assert data.startswith(MAGIC + b"Retrograph".ljust(21) + b"\r\n\0")
    sizes = data.index(b"\0", 32) + 1
    columns, rows, *lengths_mm = struct.unpack_from("<IIffff", data, sizes)
    assert (columns, rows) == (53, 37)
    assert lengths_mm == pytest.approx([53 * 0.012, 37 * 0.012, 0.0, 0.0])
    heights_mm = np.frombuffer(data, "<f4", -1, sizes + 24).reshape(37, 53)
    assert np.array_equal(np.isnan(heights_mm), np.isnan(z_um))
    assert np.nanmax(np.abs(heights_mm * 1e3 - z_um)) < 1e-6


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("doubts", [(), ("no zero: heights are relative",)])
def test_surfalize_reads_it(doubts: tuple[str, ...], tmp_path: Path, z_um: Float32Array) -> None:
    surfalize = pytest.importorskip("surfalize", reason="surfalize is not installed")
    path = tmp_path / "a.tmd"
    with path.open("wb") as file:
        write_tmd(file, SourceSurface(name="any name", z_um=z_um, pitch_um=12.0, origin="origin", doubts=doubts))
    found = surfalize.Surface.load(str(path))  # it takes the file's mm for its own µm
    assert (found.step_x, found.step_y) == pytest.approx((0.012, 0.012))
    assert np.array_equal(np.isnan(found.data), np.isnan(z_um))
    assert np.nanmax(np.abs(found.data * 1e3 - z_um)) < 1e-6


def test_what_was_written_is_read(exported: Callable[..., Path], z_um: Float32Array) -> None:
    found = read_tmd(exported("tmd"))
    assert found.pitch_um == pytest.approx(12.0, rel=1e-6)
    assert np.array_equal(np.isnan(found.z_um), np.isnan(z_um))
    assert np.nanmax(np.abs(found.z_um - z_um)) < 2e-6


def test_a_doubtful_file_stays_doubtful(tmp_path: Path, z_um: Float32Array) -> None:
    doubts = ("no zero: heights are relative", "failed calibration: it did not pass")
    surface = SourceSurface(name="part", z_um=z_um, pitch_um=12.0, doubts=doubts, short_doubts=("no zero",))
    first, second = tmp_path / "first", tmp_path / "second"
    export_surface(surface, ["tmd"], first, ExportChoices())
    assert read_tmd(first / "part.tmd").doubts == doubts
    assert main(["export", str(first / "part.tmd"), "--to", "tmd", "npz", "--out", str(second)]) == 0
    assert read_tmd(second / "part.tmd").doubts == doubts
    with np.load(second / "part.npz") as held:
        assert tuple(held["doubts"]) == doubts
    (second / "part.tmd.doubts.txt").unlink()
    (alone,) = read_tmd(second / "part.tmd").doubts
    assert "part.tmd.doubts.txt with the reasons is not next to it" in alone


def test_a_surface_without_doubts_takes_away_those_of_the_one_it_replaces(tmp_path: Path, z_um: Float32Array) -> None:
    surface = SourceSurface(name="part", z_um=z_um, pitch_um=12.0)
    beside = tmp_path / "part.tmd.doubts.txt"
    beside.write_text("part\nno zero: heights are relative\n")
    with pytest.raises(ExportError, match="exists already"):
        export_surface(surface, ["tmd"], tmp_path, ExportChoices())
    export_surface(surface, ["tmd"], tmp_path, ExportChoices(overwrite=True))
    assert not beside.exists()
    assert read_tmd(tmp_path / "part.tmd").doubts == ()


def test_a_file_of_gelsights_own_is_read_and_exported(tmp_path: Path) -> None:
    path = DATA / "groove" / "heightmap.tmd"
    if not path.is_file():
        pytest.skip(f"real files are not here: set RETROGRAPH_DATA (looked in {DATA})")
    found = read_tmd(path)
    assert found.z_um.shape == (514, 616)
    assert found.pitch_um == pytest.approx(27.458, abs=1e-3)
    assert np.isfinite(found.z_um).all()
    assert 20.0 < np.ptp(found.z_um) < 2000.0  # a groove, not kilometres
    assert main(["export", str(path), "--to", "npz", "--out", str(tmp_path)]) == 0
    with np.load(tmp_path / "heightmap.npz") as held:
        assert np.array_equal(held["z_um"], found.z_um)


def head(columns: int, rows: int, across_mm: float = 1.0, down_mm: float = 1.0) -> bytes:
    return MAGIC + b"comment\0" + struct.pack("<IIffff", columns, rows, across_mm, down_mm, 0.0, 0.0)


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "is no TMD file"),
        (b"\x89PNG\r\n", "is no TMD file"),
        (b"Binary TrueMap Data File\r\n\0", "another version"),
        (MAGIC + b"endless comment" * 1000, "ends before"),
        (MAGIC + b"c\0\1\0", "ends before"),
        (head(2, 2) + b"\0" * 15, "too short for the 2x2"),
        (head(0, 7), "too short"),
        (head(2**32 - 1, 2**32 - 1) + b"\0" * 99, "too short"),
        (head(2, 2, 1.0, 3.0) + b"\0" * 16, "square pixels"),
        (head(2, 2, float("nan"), 1.0) + b"\0" * 16, "square pixels"),
        (head(2, 2, 0.0, 0.0) + b"\0" * 16, "must be positive"),
        (head(2, 2) + b"\xff" * 16, "no height is valid"),
    ],
)
def test_what_is_none_is_refused_in_a_sentence(data: bytes, reason: str, tmp_path: Path) -> None:
    path = tmp_path / "a.tmd"
    path.write_bytes(data)
    with pytest.raises(ExportError, match=reason) as refused:
        read_tmd(path)
    assert str(path) in str(refused.value)
