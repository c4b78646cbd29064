"""STEP files of the housing's parts: one closed, valid solid each, as large as the STL of the same source."""

import os
import re
import shutil
import subprocess
from pathlib import Path

import csg_tree
import pytest
import trimesh

ROOT = Path(__file__).parents[2]
SOURCE = ROOT / "board" / "enclosure" / "retrograph.scad"
WRITER = ROOT / ".ci" / "step" / "step_write.py"
TOOL = Path(os.environ.get("STEP_TOOL", ROOT / ".step-tool")) / "bin" / "python"
QUICK = ("led_holder", "gel_frame", "saddle", "panel_post", "panel_clip", "cap", "block")
SLOW = ("camera_plate", "tray", "panel_frame", "body")
MANY_BORES = "plate"
"""Its STL takes minutes."""
CUBE = "cube(size = [1, 1, 1], center = false);\n"
LARGEST_DIFFERENCE = 0.005
"""A circle of 72 sides is 0.13 % smaller than the circle, and so are the parts."""

needs_openscad = pytest.mark.skipif(shutil.which("openscad") is None, reason="openscad is not installed")
needs_tool = pytest.mark.skipif(
    not TOOL.exists(), reason="Open CASCADE's binding is not installed: run `make step` once"
)


def exported(part: str, out: Path) -> Path:
    environment = {"PATH": "/usr/bin:/bin", "HOME": str(out.parent), "QT_QPA_PLATFORM": "offscreen"}
    command = ["openscad", "-D", f'part="{part}"', "-o", out, SOURCE]
    ran = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    assert ran.returncode == 0, ran.stderr
    return out


def written(csg: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([TOOL, WRITER, csg], capture_output=True, text=True, check=False)


def volumes_agree(part: str, folder: Path) -> None:
    ran = written(exported(part, folder / "part.csg"))
    assert ran.returncode == 0, ran.stderr
    found = re.search(r"part\.step ([\d.]+) mm3\n", ran.stdout)
    assert found, ran.stdout
    mesh = trimesh.load_mesh(exported(part, folder / "part.stl"))
    assert mesh.is_watertight
    assert float(found[1]) == pytest.approx(mesh.volume, rel=LARGEST_DIFFERENCE)
    text = (folder / "part.step").read_text(encoding="utf-8")
    assert text.count("MANIFOLD_SOLID_BREP") == 1
    assert "SI_UNIT(.MILLI.,.METRE.)" in text
    # Bores are cylinders and not facets, unless a part has none.
    assert "CYLINDRICAL_SURFACE" in text
    assert "B_SPLINE_SURFACE" not in text


@needs_openscad
@needs_tool
@pytest.mark.parametrize("part", QUICK)
def test_a_step_file_is_as_large_as_its_stl(part: str, tmp_path: Path) -> None:
    volumes_agree(part, tmp_path)


@pytest.mark.slow
@needs_openscad
@needs_tool
@pytest.mark.parametrize("part", SLOW)
def test_so_is_that_of_a_large_part(part: str, tmp_path: Path) -> None:
    volumes_agree(part, tmp_path)


@needs_tool
@pytest.mark.parametrize(
    ("csg", "sentence"),
    [
        (
            CUBE + "multmatrix([[1, 0, 0, 5], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]) {" + CUBE + "}",
            "holds 2 solids",
        ),
        ("group() { }", "holds no solid"),
        ("sphere($fn = 5, r = 3);", "CSG has sphere, which no solid is made of here"),
        ("cube(size = [1, 1, 1], center = true);", "a centred cube is not understood"),
    ],
)
def test_what_is_no_single_solid_is_refused(csg: str, sentence: str, tmp_path: Path) -> None:
    (tmp_path / "part.csg").write_text(csg, encoding="utf-8")
    ran = written(tmp_path / "part.csg")
    assert ran.returncode == 1
    assert sentence in ran.stderr
    assert ran.stderr.count("\n") == 1


def test_csg_becomes_a_tree_with_its_arguments() -> None:
    tree = csg_tree.parse(
        "multmatrix([[1, 0], [0, -1]]) {\n\tcylinder($fn = 48, h = 9.5, r1 = 2, r2 = 2, center = false);\n}\n"
        "color([1, 0.5, 0, 1]) {\n\tcube(size = [1, 2, 3], center = true);\n}\n"
    )
    motion, colour = tree.children
    assert motion.arguments == {"": [[1, 0], [0, -1]]}
    assert motion.children[0].arguments == {"$fn": 48, "h": 9.5, "r1": 2, "r2": 2, "center": False}
    assert colour.children[0].arguments == {"size": [1, 2, 3], "center": True}


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("minkowski() { }", "CSG has minkowski"),
        ("group() {", "ends within a group"),
        ("}", "never opened"),
        ("group() { } what", "not understood from 'what'"),
    ],
)
def test_csg_that_is_not_understood_is_refused(text: str, sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        csg_tree.parse(text)


@needs_openscad
def test_all_that_the_parts_are_made_of_is_understood(tmp_path: Path) -> None:
    for part in (*QUICK, *SLOW, MANY_BORES):
        tree = csg_tree.parse(exported(part, tmp_path / f"{part}.csg").read_text(encoding="utf-8"))
        assert tree.children, part
