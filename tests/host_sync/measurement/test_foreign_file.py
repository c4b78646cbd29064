"""Files of other instruments are measured as results are: their heights, scale, holes and orientation are kept."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from host_sync.cli.main import main
from host_sync.errors import MeasurementError
from host_sync.export.source_surface import SourceSurface
from host_sync.export.surface_export import ExportChoices, export_surface
from host_sync.measurement.foreign_file import read_foreign


def surface() -> np.ndarray:
    """A surface whose every flip shows, with a hole."""
    row, column = np.mgrid[0:37, 0:53]
    bump = 5.0 * np.exp(-((row - 8.0) ** 2 + (column - 40.0) ** 2) / 20.0)
    z_um = (0.3 * row + 0.05 * column + bump - 2.0).astype(np.float32)
    z_um[:6, :9] = np.nan
    return z_um


def written(form: str, folder: Path) -> Path:
    (path,), _ = export_surface(SourceSurface("part", surface(), 12.0), (form,), folder, ExportChoices())
    return path


@pytest.mark.parametrize("form", ["tmd", "x3p", "sur", "sdf", "al3d", "gwy"])
def test_a_file_is_read_as_it_was_written(form: str, tmp_path: Path) -> None:
    if form != "tmd":
        pytest.importorskip("SurfaceTopography", reason="the extra `formats` is not installed")
    found = read_foreign(written(form, tmp_path))
    assert found.height.pitch_um == pytest.approx(12.0, rel=1e-5)
    np.testing.assert_array_equal(np.isnan(found.height.z_um), np.isnan(surface()))
    assert np.nanmax(np.abs(found.height.z_um - surface())) < 2e-6
    assert [doubt.kind for doubt in found.doubts] == ["no zero"]


def test_a_foreign_file_is_measured_and_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = written("tmd", tmp_path)
    assert main(["measure", str(path), "--parameters", "Sa"]) == 0
    text = capsys.readouterr().out
    assert "± not known: a foreign file states none" in text
    assert "doubt: no zero" in text
    assert main(["report", str(path), "--no-pdf", "--out", str(tmp_path / "out")]) == 0
    assert "part.tmd" in (tmp_path / "out" / "part.html").read_text(encoding="utf-8")


def test_what_is_no_surface_is_refused_in_a_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "notes.x3p"
    path.write_bytes(b"no surface at all")
    with pytest.raises(MeasurementError, match=r"notes\.x3p"):
        read_foreign(path)
    assert main(["measure", str(path)]) == 2
    assert "Traceback" not in capsys.readouterr().err


def test_a_folder_of_results_is_measured(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["measure", str(tmp_path), "--parameters", "Sa"]) == 2
    assert "holds no result.json" in capsys.readouterr().err
