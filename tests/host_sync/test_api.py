"""The public face for Python programs: every example runs, and importing it is light."""

from __future__ import annotations

import doctest
import inspect
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from mosaic_presses import press_of_map, pressed, rough_target, write_press
from pressed_frames import write_frame_set

from host_sync import api
from host_sync.calibration_file.cache import SETTING
from host_sync.errors import FrameSetError, IntegrationError
from host_sync.mosaic.motion import Motion

PUBLIC = {
    name: item
    for name, item in vars(api).items()
    if getattr(item, "__module__", "") == api.__name__ and not name.startswith("_")
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The folder in which the examples stand: a frame set, its calibration, and a result."""
    folder = write_frame_set(tmp_path_factory.mktemp("api") / "set").parent
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(SETTING, str(folder / "cache"))
        kept = api.calibrate_frame_set(folder / "frameset.toml")
        kept.write(folder / "gel.calibration")
        api.reconstruct(folder / "ball-6.png", kept, out=folder / "results" / "ball")
        random, target = np.random.default_rng(3), rough_target((240, 400))
        for name, right_px in (("left", -60.0), ("right", 60.0)):
            seen = pressed(target, Motion(0.0, right_px), (136, 182), random)
            write_press(press_of_map(name, seen), folder / "results")
        patch.chdir(folder)
        yield folder


@pytest.mark.parametrize("name", [api.__name__, *PUBLIC])
def test_every_example_runs(name: str, folder: Path) -> None:
    item = PUBLIC.get(name, api)
    found = [
        one
        for one in doctest.DocTestFinder(recurse=item is not api).find(item, name, module=api, globs=dict(vars(api)))
        if one.examples
    ]
    assert found, f"{name} has no example"
    runner = doctest.DocTestRunner(verbose=False)
    for one in found:
        runner.run(one)
    assert runner.failures == 0


def test_the_public_face_is_what_the_document_says(folder: Path) -> None:
    document = (Path(__file__).parents[2] / "docs" / "api.md").read_text(encoding="utf-8")
    assert {name for name in PUBLIC if f"api.{name}" not in document} == set()


def test_every_argument_and_result_has_a_type() -> None:
    for name, item in PUBLIC.items():
        if inspect.isfunction(item):
            assert set(item.__annotations__) == {*inspect.signature(item).parameters, "return"}, name


def test_importing_it_loads_nothing_that_computes() -> None:
    program = "import sys; from host_sync import api; print(*sys.modules)"
    said = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert {"numpy", "numba", "scipy", "cv2", "matplotlib", "msgspec"}.isdisjoint(said.stdout.split())


def test_arrays_and_files_give_the_same_bits(folder: Path) -> None:
    kept = api.load_calibration("gel.calibration")
    stored = cv2.imread("ball-6.png", cv2.IMREAD_UNCHANGED)[..., ::-1]
    from_file, from_array = (api.reconstruct(image, kept).height_um for image in ("ball-6.png", stored))
    np.testing.assert_array_equal(from_file, from_array)
    light = (stored / 65535.0).astype(np.float32)
    np.testing.assert_allclose(api.reconstruct(light, kept).height_um, from_file, atol=0.01)
    np.testing.assert_array_equal(api.load_result("results/ball").height_um, from_file)


NO_FRAMES: dict[str, Callable[[], object]] = {
    "grey": lambda: np.zeros((20, 30)),
    "too bright": lambda: np.full((20, 30, 3), 200.0),
    "not finite": lambda: np.full((20, 30, 3), np.nan),
    "of a strange type": lambda: np.zeros((20, 30, 3), np.int64),
    "two files": lambda: ("flat.png", "flat.png"),
    "missing": lambda: "nothing.png",
}


@pytest.mark.parametrize("name", NO_FRAMES)
def test_what_is_no_frame_is_refused(folder: Path, name: str) -> None:
    kept = api.load_calibration("gel.calibration")
    with pytest.raises(FrameSetError):
        api.reconstruct(NO_FRAMES[name](), kept)  # type: ignore[arg-type]


def test_holes_stay_holes_and_shapes_must_agree() -> None:
    p = np.zeros((40, 50))
    p[10, 10] = np.nan
    weights = np.ones((40, 50))
    weights[20:24, 20:24] = 0.0
    z_um = api.integrate(p, 0.0 * weights, weights)
    assert np.isnan(z_um[10, 10])
    assert np.isnan(z_um[20:24, 20:24]).all()
    assert np.isnan(z_um).sum() == 17
    with pytest.raises(IntegrationError):
        api.integrate(p, p.T)
