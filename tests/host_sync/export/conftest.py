"""A surface whose every flip shows, as a result folder, and the command that exports it."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

from device.surface import Float32Array
from host_sync.cli.main import main

ROWS, COLUMNS, PITCH_UM = 37, 53, 12.0
Export = Callable[..., Path]
Channels = dict[int, dict[str, Any]]


@pytest.fixture
def z_um() -> Float32Array:
    """A tilted plane with a bump at the upper right, a hole at the upper left and one invalid pixel within, µm."""
    row, column = np.mgrid[0:ROWS, 0:COLUMNS]
    bump = 5.0 * np.exp(-((row - 8.0) ** 2 + (column - 40.0) ** 2) / 20.0)
    z = (0.3 * row + 0.05 * column + bump - 2.0).astype(np.float32)
    z[:6, :9] = np.nan
    z[20, 30] = np.nan
    return z


@pytest.fixture
def sigma_um(z_um: Float32Array) -> Float32Array:
    """An uncertainty that grows from left to right, µm, invalid where the height is."""
    sigma = np.broadcast_to(0.01 + 0.001 * np.arange(COLUMNS), z_um.shape).astype(np.float32)
    return np.where(np.isfinite(z_um), sigma, np.float32(np.nan))


@pytest.fixture
def write_result(tmp_path: Path) -> Callable[..., Path]:
    """Writes a result folder as reconstruct does."""

    def write(z: Float32Array, sigma: Float32Array | None = None, **said: Any) -> Path:
        folder = tmp_path / "result"
        folder.mkdir(exist_ok=True)
        tifffile.imwrite(folder / "height_um.tif", z, tile=(256, 256))
        if sigma is not None:
            tifffile.imwrite(folder / "height_sigma_um.tif", sigma, tile=(256, 256))
        record = {
            "schema": "retrograph.result/1",
            "name": "part-7",
            "rows": z.shape[0],
            "columns": z.shape[1],
            "pixel_pitch_um": PITCH_UM,
            "program": "retrograph 0.1.0",
            "calibration_id": "cal-1",
            "written_utc": "2026-11-21T14:30:05Z",
        }
        (folder / "result.json").write_text(json.dumps(record | said))
        return folder

    return write


@pytest.fixture
def result(write_result: Callable[..., Path], z_um: Float32Array, sigma_um: Float32Array) -> Path:
    return write_result(z_um, sigma_um)


@pytest.fixture
def exported(result: Path, tmp_path: Path) -> Export:
    """Exports the surface to one format by the command; returns the file."""

    def export(form: str, *options: str) -> Path:
        out = tmp_path / "out"
        assert main(["export", str(result), "--to", form, "--out", str(out), *options]) == 0
        return out / f"part-7.{'tif' if form == 'tiff' else form}"

    return export


@pytest.fixture
def gwyddion(tmp_path: Path) -> Callable[[Path], Channels]:
    """Reads a file through Gwyddion, which converts it, and gwyfile: fields, sizes, masks by channel."""
    gwyfile = pytest.importorskip("gwyfile", reason="gwyfile is not installed")

    def read(path: Path) -> Channels:
        converted = tmp_path / "converted.gwy"
        try:
            ended = subprocess.run(
                ["gwyddion", f"--convert-to-gwy={converted}", path],
                capture_output=True,
                text=True,
                check=False,
                timeout=60,
                env={"PATH": "/usr/bin:/bin", "HOME": str(tmp_path)},
            )
        except FileNotFoundError:
            pytest.skip("gwyddion is not installed: .ci/test-deps does that")
        assert ended.returncode == 0, ended.stderr
        held = gwyfile.load(str(converted))
        found: Channels = {}
        for number in (0, 1):
            if (field := held.get(f"/{number}/data")) is not None:
                mask = held.get(f"/{number}/mask")
                found[number] = {
                    "values": field.data,
                    "size": (field.xreal, field.yreal),
                    "unit": (field.si_unit_z.unitstr if field.si_unit_z else "").strip(),
                    "masked": None if mask is None else mask.data > 0.5,
                    "title": held.get(f"/{number}/data/title"),
                }
        return found

    return read
