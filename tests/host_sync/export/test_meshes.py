"""Meshes in independent readers: places, units, winding, holes, colours, decimation."""

from __future__ import annotations

import json
import re
import struct
import subprocess
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from device.surface import Float32Array
from host_sync.cli.main import main
from host_sync.export.source_surface import SourceSurface
from host_sync.export.surface_export import ExportChoices, export_surface

PITCH_UM, ROWS = 12.0, 37
UNIT_UM = {"ply": 1e3, "stl": 1e3, "obj": 1e3, "glb": 1e6}
"""Micrometres in the unit of a format's numbers."""
Export = Callable[..., Path]


@pytest.fixture
def trimesh() -> ModuleType:
    return pytest.importorskip("trimesh", reason="trimesh is not installed")


def load(trimesh: ModuleType, path: Path) -> Any:
    return trimesh.load(str(path), force="mesh", process=False)


def full_squares(z_um: Float32Array) -> int:
    """Triangles that a grid with holes has: two a square of four valid pixels, one of three."""
    valid = np.isfinite(z_um)
    corners = sum(part.astype(int) for part in (valid[:-1, :-1], valid[:-1, 1:], valid[1:, :-1], valid[1:, 1:]))
    return int(2 * (corners == 4).sum() + (corners == 3).sum())


@pytest.mark.parametrize("form", UNIT_UM)
def test_every_valid_pixel_is_a_vertex_in_its_place(
    form: str, trimesh: ModuleType, exported: Export, z_um: Float32Array
) -> None:
    mesh = load(trimesh, exported(form))
    places_um = np.asarray(mesh.vertices) * UNIT_UM[form]
    columns = np.rint(places_um[:, 0] / PITCH_UM).astype(int)
    rows = ROWS - 1 - np.rint(places_um[:, 1] / PITCH_UM).astype(int)  # the top row is the highest in y
    assert np.abs(columns * PITCH_UM - places_um[:, 0]).max() < 1e-3
    assert np.abs(places_um[:, 2] - z_um[rows, columns]).max() < 2e-6
    seen = np.zeros(z_um.shape, bool)
    seen[rows, columns] = True
    assert np.array_equal(seen, np.isfinite(z_um))


@pytest.mark.parametrize("form", UNIT_UM)
def test_triangles_face_the_camera_and_leave_holes(
    form: str, trimesh: ModuleType, exported: Export, z_um: Float32Array
) -> None:
    mesh = load(trimesh, exported(form))
    assert len(mesh.faces) == full_squares(z_um)
    corners = np.asarray(mesh.vertices)[np.asarray(mesh.faces)] * UNIT_UM[form]
    turned = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2]
    assert turned == pytest.approx(PITCH_UM**2, rel=1e-3)  # each half a pixel, all counter-clockwise
    assert np.ptp(corners[:, :, :2], axis=1).max() < 1.001 * PITCH_UM  # none spans a hole


def test_admesh_finds_stl_sound(exported: Export, z_um: Float32Array) -> None:
    try:
        # It prints the 80 bytes of an STL's header and what follows them in its memory, which is no text.
        command = ["admesh", "--exact", "--normal-directions", exported("stl")]
        ended = subprocess.run(command, capture_output=True, text=True, errors="replace", check=True)
    except FileNotFoundError:
        pytest.skip("admesh is not installed: .ci/test-deps does that")
    found = {key.strip(): value for key, value in re.findall(r"([A-Za-z ]+?)\s*:\s+(-?\d+)", ended.stdout)}
    assert int(found["Number of facets"]) == full_squares(z_um)
    for wrong in ("Degenerate facets", "Edges fixed", "Facets reversed", "Normals fixed"):
        assert int(found[wrong]) == 0


@pytest.mark.parametrize("form", UNIT_UM)
def test_assimp_agrees_on_extent_and_faces(form: str, exported: Export, z_um: Float32Array) -> None:
    try:
        ended = subprocess.run(
            ["assimp", "info", exported(form), "--raw"], capture_output=True, text=True, check=True
        ).stdout
    except FileNotFoundError:
        pytest.skip("assimp is not installed: .ci/test-deps does that")
    faces = re.search(r"^Faces:\s+(\d+)", ended, re.MULTILINE)
    highest = re.search(r"^Maximum point\s+\(\s*(\S+)\s+(\S+)\s+(\S+)\)", ended, re.MULTILINE)
    assert faces is not None
    assert highest is not None
    assert int(faces[1]) == full_squares(z_um)
    extent = [52 * PITCH_UM, 36 * PITCH_UM, float(np.nanmax(z_um))]
    assert [float(value) for value in highest.groups()] == pytest.approx(
        [value / UNIT_UM[form] for value in extent], abs=1e-6
    )


def test_ply_colours_grow_brighter_with_height(trimesh: ModuleType, exported: Export) -> None:
    mesh = load(trimesh, exported("ply"))
    light = np.asarray(mesh.visual.vertex_colors)[:, :3].sum(axis=1, dtype=int)
    heights = np.asarray(mesh.vertices)[:, 2]
    order = np.argsort(heights)
    assert light[order[-20:]].min() > light[order[:20]].max() + 200
    assert np.corrcoef(heights, light)[0, 1] > 0.95


def glb_part(path: Path, name: str) -> np.ndarray:
    """An attribute of a GLB's only mesh, by the specification's own words."""
    data = path.read_bytes()
    magic, version, length, json_length, json_kind = struct.unpack_from("<4sII I4s", data)
    assert (magic, version, length, json_kind) == (b"glTF", 2, len(data), b"JSON")
    said = json.loads(data[20 : 20 + json_length])
    binary = data[20 + json_length + 8 :]
    accessor = said["accessors"][said["meshes"][0]["primitives"][0]["attributes"][name]]
    view = said["bufferViews"][accessor["bufferView"]]
    kind = {5126: "<f4", 5123: "<u2"}[accessor["componentType"]]
    values = np.frombuffer(binary[view["byteOffset"] :][: view["byteLength"]], kind)
    return values.reshape(accessor["count"], -1)


def test_glb_colours_are_those_of_ply_in_linear_light_and_normals_fit(
    trimesh: ModuleType, exported: Export, z_um: Float32Array
) -> None:
    glb = exported("glb")
    shown = np.asarray(load(trimesh, exported("ply")).visual.vertex_colors)[:, :3] / 255.0
    linear = glb_part(glb, "COLOR_0") / 65535.0
    assert (linear[:, 3] == 1.0).all()
    assert (
        np.abs(np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4) - linear[:, :3]).max() < 1e-4
    )
    normals = glb_part(glb, "NORMAL")
    assert np.linalg.norm(normals, axis=1) == pytest.approx(1.0, abs=1e-6)
    # Lower right of the field: z = 0.3 row + 0.05 column, µm; y is up.
    expected = np.array([-0.05 / PITCH_UM, 0.3 / PITCH_UM, 1.0])
    assert normals[-60:] == pytest.approx(np.tile(expected / np.linalg.norm(expected), (60, 1)), abs=1e-6)


def test_a_mesh_step_keeps_heights_and_says_so_when_it_is_needed(
    trimesh: ModuleType, exported: Export, z_um: Float32Array
) -> None:
    mesh = load(trimesh, exported("ply", "--mesh-step", "4"))
    kept = z_um[::4, ::4]
    assert np.asarray(mesh.vertices)[:, 2] * 1e3 == pytest.approx(kept[np.isfinite(kept)], abs=2e-6)
    assert np.asarray(mesh.vertices)[:, :2].max(axis=0) * 1e3 == pytest.approx([52 * PITCH_UM, 36 * PITCH_UM])


def test_a_large_field_is_refused_with_the_step_that_is_enough(
    write_result: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write_result(np.zeros((1500, 2000), np.float32))
    out = tmp_path / "out"
    assert main(["export", str(folder), "--to", "gsf", "stl", "--out", str(out)]) == 1
    said = capsys.readouterr().err
    assert "6 million triangles" in said
    assert "--mesh-step 2" in said
    assert [path.name for path in out.iterdir()] == ["part-7.gsf"]
    assert main(["export", str(folder), "--to", "stl", "--out", str(out), "--mesh-step", "2"]) == 0
    assert (out / "part-7.stl").stat().st_size == 84 + 50 * 2 * 749 * 999


@pytest.mark.parametrize("step", ["0", "-1", "40"])
def test_a_step_that_leaves_nothing_is_refused(
    step: str, result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export", str(result), "--to", "obj", "--out", str(tmp_path / "out"), "--mesh-step", step]) == 2
    assert "step" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("shown", ["whole", "holes", "touching"])
def test_a_base_makes_it_watertight(shown: str, tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh", reason="trimesh is not installed")
    row, column = np.mgrid[:30, :40].astype(np.float32)
    z_um = 100.0 * np.sin(row / 6.0) * np.cos(column / 8.0)
    if shown != "whole":
        z_um[5:9, 5:12] = z_um[0, 30:33] = np.nan
    if shown == "touching":
        z_um[9:14, 12:18] = z_um[20, 20] = z_um[22, 22] = np.nan
    surface = SourceSurface(name="part", z_um=z_um.astype(np.float32), pitch_um=20.0)
    (path,), _ = export_surface(surface, ["stl"], tmp_path, ExportChoices(base_mm=1.5))
    solid = trimesh.load_mesh(path)
    assert solid.is_watertight
    assert solid.is_winding_consistent
    assert solid.volume > 0.0
    low, high = solid.bounds
    assert high[2] == pytest.approx(np.nanmax(z_um) / 1e3, abs=1e-4)
    assert low[2] == pytest.approx(np.nanmin(z_um) / 1e3 - 1.5, abs=2e-3)
    if shown == "whole":
        middle = (z_um[:-1, :-1] + z_um[1:, 1:] + z_um[:-1, 1:] + z_um[1:, :-1]) / 4.0
        expected = (middle / 1e3 - low[2]).sum() * 0.02**2
        assert solid.volume == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("base_mm", ["0", "-1", "nan", "1e9"])
def test_a_base_without_a_thickness_is_refused(
    base_mm: str, result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = str(tmp_path / "out")
    assert main(["export", str(result), "--to", "stl", "--out", out, "--base-mm", base_mm]) == 2
    assert "a base is up to" in capsys.readouterr().err
    assert not list((tmp_path / "out").glob("*"))


def test_other_formats_are_written_where_the_mesh_is_too_large(
    result: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("host_sync.export.mesh.MAX_VERTICES", 100)
    out = tmp_path / "out"
    assert main(["export", str(result), "--to", "gsf", "x3p", "glb", "stl", "--out", str(out)]) == 1
    assert sorted(path.name for path in out.iterdir()) == ["part-7.gsf", "part-7.x3p"]
    said = capsys.readouterr()
    assert said.out.split() == [str(out / "part-7.gsf"), str(out / "part-7.x3p")]
    (line,) = said.err.splitlines()
    assert line.startswith("retrosync: glb, stl: ")
    assert "--mesh-step" in line
    assert main(["export", str(result), "--to", "glb", "--out", str(out)]) == 2
