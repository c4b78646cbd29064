"""The public face for Python programs: every example runs, and importing it is light."""

from __future__ import annotations

import doctest
import inspect
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np
import pytest
from mosaic_presses import press_of_map, pressed, rough_target, write_press
from pressed_frames import write_frame_set

from device.align import Pose
from device.errors import OutputError
from host_sync import api
from host_sync.calibration_file.kept_calibration import KeptCalibration
from host_sync.errors import (
    ArgumentError,
    CalibrationFileError,
    FrameSetError,
    HostError,
    IntegrationError,
    LibraryError,
    MosaicError,
    UnreadableResult,
)
from host_sync.video import frame_solver

PUBLIC = {
    name: item
    for name, item in vars(api).items()
    if getattr(item, "__module__", "") in {api.__name__, "host_sync.api_types"} and not name.startswith("_")
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The folder in which the examples stand: a frame set, its calibration, and a result."""
    folder = write_frame_set(tmp_path_factory.mktemp("api") / "set").parent
    with pytest.MonkeyPatch.context() as patch:
        kept = api.calibrate_frame_set(folder / "frameset.toml")
        kept.write(folder / "gel.calibration")
        api.reconstruct(folder / "ball-6.png", kept, out=folder / "results" / "ball")
        random, target = np.random.default_rng(3), rough_target((240, 400))
        for name, right_px in (("left", -60.0), ("right", 60.0)):
            seen = pressed(target, Pose(0.0, right_px), (136, 182), random)
            write_press(press_of_map(name, seen), folder / "results")
        (folder / "library").mkdir()
        patch.chdir(folder)
        yield folder


@pytest.mark.parametrize("name", [api.__name__, *PUBLIC])
def test_every_example_runs(name: str, folder: Path) -> None:
    item = PUBLIC.get(name, api)
    found = [
        one
        for one in doctest.DocTestFinder(recurse=item is not api).find(
            item, name, module=sys.modules[getattr(item, "__module__", api.__name__)], globs=dict(vars(api))
        )
        if one.examples
    ]
    assert found, f"{name} has no example"
    runner = doctest.DocTestRunner(verbose=False, optionflags=doctest.ELLIPSIS)
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


@pytest.mark.parametrize(
    ("widest_px", "fraction", "ratio", "light"),
    [(384, 0.98, 1.4, 1.0), (384, 0.98, 1.4, 1.04), (192, 0.9, 2.0, 1.0), (192, 0.9, 2.0, 1.04)],
)
def test_a_streamed_frame_is_the_frame_reconstructed_alone(
    folder: Path, widest_px: int, fraction: float, ratio: float, light: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Heights agree within 0.3 of their uncertainty but at the edges of shadow: at 98 of 100 places, or where slow
    changes are found on a coarse frame at nine of ten. There the uncertainty comes out up to twice as large. The second
    and third frame may be brighter than the first and the calibration."""
    monkeypatch.setattr(frame_solver, "WIDEST_PX", widest_px)
    kept = api.load_calibration("gel.calibration")
    names = ["ball-6.png", "ball-1.png", "ball-6.png"]
    if light > 1.0:
        names = ["ball-6.png", "bright-ball-1.png", "bright-ball-6.png"]
        for name in names[1:]:
            stored = cv2.imread(name.removeprefix("bright-"), cv2.IMREAD_UNCHANGED)
            cv2.imwrite(name, np.minimum(np.rint(light * stored), np.iinfo(stored.dtype).max).astype(stored.dtype))
    alone = {name: api.reconstruct(name, kept) for name in names}
    with api.stream(names, kept, sigma=True) as stream:
        assert stream.shape == (288, 384)
        for name, frame in zip(names, stream, strict=True):
            assert (frame.name, frame.problem) == (name, None)
            off = np.abs(frame.height_um - alone[name].height_um) / alone[name].sigma_um
            assert np.nanquantile(off, fraction) < 0.3
            assert 0.7 < np.nanmedian(frame.sigma_um / alone[name].sigma_um) < ratio
            assert frame.contact.depth_um == pytest.approx(float(np.nanmax(frame.height_um)), rel=0.1)
    assert stream.dropped == 0


def test_a_frame_that_is_not_checked_is_refused_for_its_light(folder: Path) -> None:
    """Red is too bright in the second frame alone."""
    stored = cv2.imread("ball-6.png", cv2.IMREAD_UNCHANGED)
    stored[..., 2] = np.rint(np.minimum(1.25 * stored[..., 2], np.iinfo(stored.dtype).max))
    cv2.imwrite("red.png", stored)
    with api.stream(["ball-6.png", "red.png", "ball-6.png"], api.load_calibration("gel.calibration")) as stream:
        first, red, last = stream
    assert (first.problem, last.problem) == (None, None)
    assert red.problem is not None
    assert "its lights differ from the calibration's by" in red.problem


def test_many_images_come_in_order_and_a_bad_one_keeps_its_place(folder: Path) -> None:
    kept = api.load_calibration("gel.calibration")
    first, absent, last = api.reconstruct_many(["ball-6.png", "nothing.png", "ball-1.png"], kept, workers=2)
    assert isinstance(absent, FrameSetError)
    np.testing.assert_array_equal(first.height_um, api.reconstruct("ball-6.png", kept).height_um)
    assert not np.array_equal(first.height_um, last.height_um)


def test_the_example_of_the_document_tracks_a_contact(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    document = (Path(__file__).parents[2] / "docs" / "api.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"```python\n(# Track.*?)```", document, re.DOTALL)
    assert len(example.splitlines()) <= 10
    (folder / "press").mkdir()
    for number in (0, 1, 2):
        shutil.copy(f"ball-{number}.png", folder / "press")
    exec(compile(example, "docs/api.md", "exec"), {})  # noqa: S102
    columns = [float(line.split()[1]) for line in capsys.readouterr().out.splitlines()]
    assert columns == pytest.approx([0.2 * 384, 0.5 * 384, 0.8 * 384], abs=6.0)


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


LABELLED = [api.Press(f"ball-{i}.png", 0.96) for i in range(6)]
MISTAKES: dict[str, tuple[Callable[[], object], str]] = {
    "no image": (lambda: api.reconstruct(None, _kept()), "a NoneType is no frame"),  # type: ignore[arg-type]
    "encoding": (lambda: api.reconstruct("flat.png", _kept(), encoding="sRGB"), "'sRGB' is not accepted"),  # type: ignore[arg-type]
    "method": (lambda: api.reconstruct("flat.png", _kept(), method="x"), "accepted: 'direct', 'paper'"),  # type: ignore[arg-type]
    "detail": (lambda: api.reconstruct("flat.png", _kept(), detail="x"), "accepted: 'shrunk', 'raw'"),  # type: ignore[arg-type]
    "paths for presses": (lambda: _calibrate(["ball-0.png"]), "press 0 is a str: give api.Press"),
    "no pitch": (lambda: _calibrate(LABELLED, pixel_pitch_um=0.0), "pixel_pitch_um 0 is out of range"),
    "no radius": (lambda: _calibrate([api.Press("ball-0.png", -1.0)]), "ball_radius_mm -1 is out of range"),
    "encoding of presses": (lambda: _calibrate(LABELLED, encoding="gamma"), "'gamma' is not accepted"),
    "a ball elsewhere": (
        lambda: _calibrate([api.Press("ball-0.png", 0.96, [(9999.0, 3.0, 20.0)])]),
        "press 0: balls[0]: its centre (9999, 3) is outside the frame, 384x288 pixels",
    ),
    "a camera in the skin": (
        lambda: api.calibrate(LABELLED, reference="flat.png", pixel_pitch_um=20.0, pupil_height_mm=-1.0),
        "pupil_height_mm -1 is out of range",
    ),
    "a pitch in a text": (lambda: _calibrate(LABELLED, pixel_pitch_um="20"), "pixel_pitch_um '20' is out of range"),
    "a radius in a text": (lambda: _calibrate([api.Press("ball-0.png", "1")]), "ball_radius_mm '1' is out of range"),  # type: ignore[arg-type]
    "a grid of no pitch": (
        lambda: _calibrate([api.Press("ball-0.png", 0.96, grid_pitch_mm=-2.0)]),
        "grid_pitch_mm -2 is out of range",
    ),
    "one ball, no list": (
        lambda: _calibrate([api.Press("ball-0.png", 0.96, (76.0, 80.0, 28.0))]),  # type: ignore[arg-type]
        "press 0: balls[0]: give (column, row, radius of the trusted contact), pixels",
    ),
    "a ball in words": (
        lambda: _calibrate([api.Press("ball-0.png", 0.96, [("left", "top", "big")])]),  # type: ignore[list-item]
        "press 0: balls[0]: give (column, row, radius of the trusted contact), pixels",
    ),
    "balls in a number": (
        lambda: _calibrate([api.Press("ball-0.png", 0.96, 3)]),  # type: ignore[arg-type]
        "press 0: balls must be a list, [(column, row, radius), ...], not int",
    ),
    "a ball without a contact": (
        lambda: _calibrate([api.Press("ball-0.png", 0.96, [(76.0, 80.0)])]),  # type: ignore[list-item]
        "give (column, row, radius of the trusted contact)",
    ),
}


def _kept() -> KeptCalibration:
    return api.load_calibration("gel.calibration")


def _calibrate(presses: Any, **changed: Any) -> object:
    return api.calibrate(presses, **{"reference": "flat.png", "pixel_pitch_um": 20.0} | changed)


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_ends_in_a_sentence(folder: Path, mistake: str) -> None:
    call, words = MISTAKES[mistake]
    with pytest.raises(FrameSetError) as raised:
        call()
    assert words in str(raised.value)


def test_a_file_of_a_calibration_is_loaded_first(folder: Path) -> None:
    with pytest.raises(CalibrationFileError, match=r"a str is no calibration: .* load_calibration returns"):
        api.reconstruct("flat.png", "gel.calibration")  # type: ignore[arg-type]


def test_a_calibration_is_written_to_a_path_in_either_form(folder: Path, tmp_path: Path) -> None:
    kept = _kept()
    kept.write(str(tmp_path / "text.calibration"))
    kept.write(tmp_path / "path.calibration")
    assert (tmp_path / "text.calibration").read_bytes() == (tmp_path / "path.calibration").read_bytes()
    with pytest.raises(OutputError, match="it is a folder"):
        kept.write(".")


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


FLAT = np.zeros((20, 30))
WRONG: dict[str, tuple[type[HostError], str, Callable[..., object]]] = {
    "a name for p": (IntegrationError, "p must be an array of numbers of shape (H, W), not str", lambda: _slopes("p")),
    "nothing for q": (IntegrationError, "q must be an array of .*, not NoneType", lambda: _slopes(FLAT, None)),
    "words": (IntegrationError, "p must hold real numbers, not texts", lambda: _slopes([["1", "2"]] * 3)),
    "rows of different lengths": (
        IntegrationError,
        "p must be an array of .*, not list",
        lambda: _slopes([[1], [1, 2]]),
    ),
    "complex slopes": (IntegrationError, "p must hold real numbers, not complex128", lambda: _slopes(FLAT + 1j)),
    "one row": (IntegrationError, "must have one shape (H, W), got p (5,), q (5,)", lambda: _slopes([0] * 5, [0] * 5)),
    "colours": (IntegrationError, "got p (9, 9, 3), q (9, 9, 3)", lambda: _slopes(*np.zeros((2, 9, 9, 3)))),
    "one transposed": (IntegrationError, "got p (20, 30), q (30, 20)", lambda: _slopes(FLAT, FLAT.T)),
    "one weight": (IntegrationError, "q (20, 30), weights ()", lambda: _slopes(FLAT, FLAT, 1.0)),
    "a name for weights": (
        IntegrationError,
        "weights must be an array of .*, not str",
        lambda: _slopes(FLAT, FLAT, "w"),
    ),
    "NaN everywhere": (IntegrationError, "no pixel has finite slopes p and q", lambda: _slopes(FLAT * np.nan)),
    "slopes beyond any float32": (IntegrationError, "no pixel has finite slopes", lambda: _slopes(FLAT + 1e300)),
    "an empty array": (IntegrationError, "no pixel has finite slopes", lambda: _slopes(*np.zeros((2, 0, 0)))),
    "a pitch in a text": (
        IntegrationError,
        "pitch_um '5' is out of range; accepted is a number above 0",
        lambda: api.integrate(FLAT, FLAT, pitch_um="5"),  # type: ignore[arg-type]
    ),
    "a folder without a result": (UnreadableResult, "holds no result.json", lambda: api.measure("results")),
    "an array to measure": (
        ArgumentError,
        "result must be a Result, or the folder of one, not ndarray",
        lambda: api.measure(FLAT),  # type: ignore[arg-type]
    ),
    "a recipe in a table": (
        ArgumentError,
        "recipe must be a text or a pathlib.Path, not dict",
        lambda: api.measure("results/ball", {"form": "plane"}),  # type: ignore[arg-type]
    ),
    "no library": (LibraryError, "nowhere: there is no library: pull", lambda: api.open_library("nowhere")),
    "a library's name left empty": (ArgumentError, "folder must name a file or", lambda: api.open_library("")),
    "a file for a library": (LibraryError, "flat.png: there is no library", lambda: api.open_library("flat.png")),
    "one folder for a list": (
        ArgumentError,
        "results must be a list of paths, not str",
        lambda: api.mosaic("results/left", "whole"),
    ),
    "results for folders": (
        ArgumentError,
        "results[0] must be a text or a pathlib.Path, not Result",
        lambda: api.mosaic([api.load_result("results/left")], "whole"),  # type: ignore[list-item]
    ),
    "one press": (MosaicError, "two presses or more", lambda: api.mosaic(["results/left"], "whole")),
    "nothing to load": (ArgumentError, "folder must be a text or .*, not NoneType", lambda: api.load_result(None)),  # type: ignore[arg-type]
    "a number for a file": (ArgumentError, "path must be a text or .*, not int", lambda: api.load_calibration(3)),  # type: ignore[arg-type]
    "a number for a frame set": (ArgumentError, "path must be a .*, not int", lambda: api.calibrate_frame_set(3)),  # type: ignore[arg-type]
    "a number for a place": (
        ArgumentError,
        "out must be a text or a pathlib.Path, not int",
        lambda: api.reconstruct("ball-6.png", _kept(), out=3),  # type: ignore[arg-type]
    ),
    "a press alone": (ArgumentError, r"presses must be a list, .*, not Press", lambda: _calibrate(LABELLED[0])),
}


def _slopes(p: Any, q: Any = FLAT, *weights: Any) -> object:
    return api.integrate(p, q, *weights)


@pytest.mark.parametrize("mistake", WRONG)
def test_a_wrong_argument_ends_in_a_sentence_of_our_own(folder: Path, mistake: str) -> None:
    kind, words, call = WRONG[mistake]
    with pytest.raises(kind, match=re.escape(words).replace(r"\.\*", ".*")) as raised:
        call()
    assert "\n" not in str(raised.value)


def test_a_folder_is_measured_like_its_result(folder: Path) -> None:
    loaded = api.measure(api.load_result("results/ball"), parameters=("Sa",))
    for place in ("results/ball", Path("results/ball")):
        assert api.measure(place, parameters=("Sa",)) == loaded


def test_masked_slopes_and_lists_are_taken() -> None:
    p = np.ma.masked_equal(np.arange(48.0).reshape(6, 8) % 8, 3.0)
    q = [[0.0] * 8] * 6
    z_um = api.integrate(0.1 * p, q)  # type: ignore[arg-type]
    np.testing.assert_array_equal(np.isnan(z_um), p.mask)


def test_every_type_in_a_signature_is_explained() -> None:
    document = (Path(__file__).parents[2] / "docs" / "api-reference.md").read_text(encoding="utf-8")
    texts = [
        str(annotation)
        for item in PUBLIC.values()
        for member in (item, *(one.fget for one in vars(item).values() if isinstance(one, property)))
        for annotation in getattr(member, "__annotations__", {}).values()
    ]
    named = set(re.findall(r"\b[A-Z]\w+", " ".join(texts))) - {"Any", "Literal", "None", "Path", "Sequence", *PUBLIC}
    assert {"Float32Array", "KeptCalibration", "Quantity", "Image"} <= named
    assert {name for name in named if f"`{name}`" not in document} == set()


def test_a_result_is_one_line_and_in_a_notebook_a_relief(folder: Path) -> None:
    result = api.load_result("results/ball")
    assert re.fullmatch(
        r"<Result ball-6: 384 x 288 pixels of 20 µm, heights -?[\d.]+ to [\d.]+ µm, ± [\d.]+ µm, \d+ doubts?>",
        repr(result),
    )
    page = result._repr_html_()
    assert '<img alt="Relief of ball-6" src="data:image/webp;base64,UklGR' in page
    assert page.count("<li>doubt: ") == len(result.warnings)
    surface = replace(result.surface, record=msgspec.structs.replace(result.surface.record, name="<b>"), sigma_um=None)
    assert "<b></b>" not in (unknown := api.Result(surface)._repr_html_())
    assert "± not known" in unknown
    assert re.fullmatch(r"<KeptCalibration \w+ of gel-3: calibration passed .*>", repr(_kept()))
    (sa,) = api.measure(result, form="plane", parameters=("Sa",))
    assert re.fullmatch(r"<Quantity surface: Sa [\d.]+ ± [\d.]+ µm.*>", repr(sa))


def test_a_result_is_a_dataset_where_xarray_is_installed(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    result = api.load_result("results/ball")
    dataset = result.to_xarray()
    assert dataset.height.dims == ("y", "x")
    np.testing.assert_array_equal(dataset.height_sigma, result.sigma_um)
    assert dataset.height.sel(y=2600.0, x=3080.0) == result.height_um[130, 154]
    assert dataset.attrs["doubts"] == result.warnings
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(ArgumentError, match=r"xarray is not installed: pip install 'retrograph\[xarray\]'"):
        result.to_xarray()
