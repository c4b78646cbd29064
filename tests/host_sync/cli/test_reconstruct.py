"""The workstation's main job from its command line: frames of the twin in, result files out, bad input refused."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from limits import running

from device.acquisition.capture import CaptureSettings, capture
from device.acquisition.scanner import Scanner
from device.bundles.scan import Annotations, ScanBundle
from device.imaging.flat_field import demosaic
from device.store.store import BundleStore
from device.surface import HeightMap, surface_slopes
from hal.board_profile import BoardProfile
from hal.clock import VirtualClock
from hal.hardware import Hardware
from hal.interfaces import LiftOff, OperatorRequest, PressBall, PressObject
from hal.simulator.bench import TwinTruth, build
from hal.simulator.hardware import twin_hardware
from host_sync.batch.library_batch import ScanOutcome
from host_sync.calibration_file.calibrator import Calibrator
from host_sync.cli.main import main, run
from host_sync.cli.reconstruct import print_outcomes
from host_sync.cli.verify import reproduce_results
from host_sync.library.library import Library
from host_sync.reconstruction.reprocess import compare
from host_sync.reconstruction.scans import LibraryReconstructor

RESULT_FILES = {
    "height_um.tif", "height_raw_um.tif",
    "slope_p.tif", "slope_q.tif", "height_sigma_um.tif", "slope_sigma.tif", "height_draws_um.tif",
    "extrapolated.png", "untouched.png", "relief.png", "result.json",
}  # fmt: skip
RADIUS_MM = 3.0
PITCH_UM = 48.0
PUPIL_MM = 160.0
PLACES = [(column, row) for row in (0.2, 0.5, 0.8) for column in (0.2, 0.5, 0.8)]


@dataclass(frozen=True)
class Frames:
    """A frame set of the twin on disk, and the truth of its good scan."""

    folder: Path
    truth: TwinTruth

    def copy(self, target: Path) -> Path:
        shutil.copytree(self.folder, target)
        return target / "frameset.toml"


def write_rgb(path: Path, rgb: np.ndarray) -> None:
    values = np.clip(np.rint(rgb * 65535.0), 0, 65535).astype(np.uint16)
    assert cv2.imwrite(str(path), values[..., ::-1])


def shoot(hardware: Hardware, request: OperatorRequest) -> np.ndarray:
    hardware.operator.ask(request)
    hardware.button.wait_for_press(None)
    return demosaic(capture(hardware, CaptureSettings.of_board(hardware))).rgb


@pytest.fixture(scope="module")
def frames(tmp_path_factory: pytest.TempPathFactory, small_twin: BoardProfile) -> Frames:
    folder = tmp_path_factory.mktemp("frames")
    bench = build(small_twin, VirtualClock())
    lines = [
        f'name = "twin"\npixel_pitch_um = {PITCH_UM}\npupil_height_mm = {PUPIL_MM}\nencoding = "linear"',
        '[reference]\nimage = "flat.png"',
    ]
    with twin_hardware(bench) as hardware:
        write_rgb(folder / "flat.png", shoot(hardware, LiftOff()))
        for number, (column, row) in enumerate(PLACES):
            write_rgb(folder / f"press{number}.png", shoot(hardware, PressBall(RADIUS_MM, column, row)))
            lines.append(f'[[press]]\nimage = "press{number}.png"\nball_radius_mm = {RADIUS_MM}')
        sphere = shoot(hardware, PressObject("sphere"))
        truth = bench.truth()
    lines.append(f'[[press]]\nimage = "flat.png"\nball_radius_mm = {RADIUS_MM}')  # nothing was pressed
    write_rgb(folder / "sphere.png", sphere)
    write_rgb(folder / "swapped.png", sphere[..., ::-1])
    write_rgb(folder / "black.png", 0.0 * sphere)
    write_rgb(folder / "bright.png", 0.0 * sphere + 1.0)
    lines.append('[[scan]]\nname = "sphere"\nimage = "sphere.png"')
    (folder / "frameset.toml").write_text("\n".join(lines) + "\n")
    return Frames(folder, truth)


@pytest.fixture(scope="module")
def results(frames: Frames, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of the good scan and three bad ones."""
    out = tmp_path_factory.mktemp("results")
    path = frames.copy(tmp_path_factory.mktemp("mixed") / "set")
    with path.open("a") as file:
        for name in ("swapped", "black", "bright"):
            file.write(f'[[scan]]\nname = "{name}"\nimage = "{name}.png"\n')
    assert main(["reconstruct", str(path), "--out", str(out)]) == 1
    return out


def inner(truth: TwinTruth) -> np.ndarray:
    """Contact pixels within 0.9 of the contact's radius."""
    rows, columns = np.nonzero(truth.contact)
    radius = np.sqrt(len(rows) / np.pi)
    row, column = np.mgrid[: truth.contact.shape[0], : truth.contact.shape[1]]
    return (row - rows.mean()) ** 2 + (column - columns.mean()) ** 2 < (0.9 * radius) ** 2


def leftovers(folder: Path) -> list[Path]:
    return [path for path in folder.rglob(".*") if path.name.endswith((".partial", ".replaced"))]


def refusal(capsys: pytest.CaptureFixture[str], arguments: list[str], code: int = 2) -> str:
    """The one sentence with which a command refuses."""
    assert main(arguments) == code
    error = capsys.readouterr().err
    sentences = [line for line in error.splitlines() if line.startswith("retrosync: ")]
    assert len(sentences) == 1
    assert "Traceback" not in error
    return sentences[0]


def test_every_result_file_is_there_and_has_the_frames_size(results: Path, frames: Frames) -> None:
    assert {path.name for path in (results / "sphere").iterdir()} == RESULT_FILES
    for name in ("height_um", "slope_p", "slope_q", "height_sigma_um"):
        field = tifffile.imread(results / "sphere" / f"{name}.tif")
        assert field.dtype == np.float32
        assert field.shape == frames.truth.z_um.shape
        assert np.isfinite(field).mean() > 0.97


def test_the_sphere_is_measured(results: Path, frames: Frames) -> None:
    height = tifffile.imread(results / "sphere" / "height_um.tif")
    judged = inner(frames.truth)
    error = np.abs(height - frames.truth.z_um)[judged]
    assert (error <= 0.02 * RADIUS_MM * 1e3).mean() > 0.9
    q, p = np.gradient(height / PITCH_UM)
    dot = p * frames.truth.p + q * frames.truth.q + 1.0
    norms = np.sqrt((1 + p**2 + q**2) * (1 + frames.truth.p**2 + frames.truth.q**2))
    angle = np.degrees(np.arccos(np.clip(dot / norms, -1, 1)))[judged]
    assert angle.mean() < 1.5
    assert (angle <= 4.0).mean() > 0.95


def test_slope_files_are_the_slopes_of_the_height(results: Path) -> None:
    height, p, q = (tifffile.imread(results / "sphere" / f"{n}.tif") for n in ("height_um", "slope_p", "slope_q"))
    across, down = surface_slopes(HeightMap(height, PITCH_UM))
    np.testing.assert_allclose(p, across, atol=1e-5)
    np.testing.assert_allclose(q, down, atol=1e-5)


def test_untouched_skin_is_zero_and_its_uncertainty_is_stated(results: Path, frames: Frames) -> None:
    height, sigma = (tifffile.imread(results / "sphere" / f"{n}.tif") for n in ("height_um", "height_sigma_um"))
    at_rest = frames.truth.z_um < 2.0
    assert abs(np.nanmedian(height[at_rest])) < 15.0
    assert (sigma[np.isfinite(sigma)] > 0.0).all()
    error = np.abs(height - frames.truth.z_um)
    for place in (at_rest, frames.truth.contact):
        covered = (error <= 2.0 * sigma)[place & np.isfinite(height)]
        assert covered.mean() > 0.8
    assert np.nanmedian(sigma) < 0.05 * frames.truth.z_um.max()


def test_the_record_says_what_was_done(results: Path) -> None:
    record = json.loads((results / "sphere" / "result.json").read_text())
    assert record["schema"] == "retrograph.result/1"
    assert record["pixel_pitch_um"] == PITCH_UM
    assert record["pupil_height_mm"] == pytest.approx(PUPIL_MM)
    assert record["method"] == "direct"
    assert record["integration"]["converged"] is True
    assert 0.0 < record["held_out_error_deg"] < 3.0


def test_the_calibration_report_names_every_ball(results: Path) -> None:
    report = json.loads((results / "calibration" / "report.json").read_text())
    assert sum(len(press["balls"]) for press in report["presses"]) == len(PLACES)
    assert report["calibration_id"] == json.loads((results / "sphere" / "result.json").read_text())["calibration_id"]
    assert report["passed"] is True
    assert report["presses"][3]["image"] == "press3.png"
    assert report["next_presses"] == []
    assert report["sources"] >= 3
    assert report["confirmed"] == 1.0
    assert report["reads"] in ("intensity", "slopes of a matt skin under near lights")
    elevation, (ball, *_) = report["slope_error"]["elevation"], report["presses"][0]["balls"]
    assert (
        ball["radius_px"] > elevation["apex_px"] > ball["radius_px"] - np.sqrt(ball["radius_px"] ** 2 - ball["r"] ** 2)
    )
    assert elevation["radius_px"] == pytest.approx(ball["radius_px"])
    assert report["scale_uncertainty"]["pixel_pitch_sigma_um"] is None
    pictures = {path.name for path in (results / "calibration").glob("*.png")}
    assert pictures == {"residuals.png", "balls.png"}


def test_bad_scans_are_named_and_leave_nothing(
    frames: Frames, tmp_path: Path, capsys: pytest.CaptureFixture[str], results: Path
) -> None:
    assert sorted(path.name for path in results.iterdir()) == ["calibration", "sphere"]
    path = frames.copy(tmp_path / "set")
    with path.open("a") as file:
        for name in ("swapped", "black", "bright"):
            file.write(f'[[scan]]\nname = "{name}"\nimage = "{name}.png"\n')
    assert main(["reconstruct", str(path), "swapped", "black", "bright", "--out", str(tmp_path / "out")]) == 2
    errors = capsys.readouterr().err
    assert "Traceback" not in errors
    assert "swapped.png was not made as its calibration was: the channels are in the order B, G, R" in errors
    assert "black.png is black" in errors
    assert "bright.png is saturated" in errors
    assert [entry.name for entry in (tmp_path / "out").iterdir()] == ["calibration"]


@pytest.mark.slow
def test_the_papers_method_and_its_detail_filter_can_be_asked_for(frames: Frames, tmp_path: Path) -> None:
    path = frames.copy(tmp_path / "set")
    asked = ["--method", "paper", "--s-filter-um", "100", "--l-filter-um", "1500"]
    assert main(["reconstruct", str(path), "--out", str(tmp_path / "out"), *asked]) == 0
    folder = tmp_path / "out" / "sphere"
    assert {path.name for path in folder.iterdir()} == RESULT_FILES | {"detail_um.tif", "detail.png"}
    detail = json.loads((folder / "result.json").read_text())["detail"]
    assert (detail["s_nesting_index_um"], detail["l_nesting_index_um"]) == (100.0, 1500.0)
    fine = tifffile.imread(folder / "detail_um.tif")
    assert 0.0 < detail["rms_um"] == pytest.approx(float(np.nanstd(fine)), rel=1e-3)
    assert detail["rms_um"] < 0.2 * frames.truth.z_um.max()
    record = json.loads((tmp_path / "out" / "sphere" / "result.json").read_text())
    assert record["method"] == "paper"
    pictures = {path.name for path in (tmp_path / "out" / "calibration").glob("*.png")}
    assert {"reflectance-maps.png", "ambiguous-bins.png"} < pictures
    height = tifffile.imread(tmp_path / "out" / "sphere" / "height_um.tif")
    error = np.abs(height - frames.truth.z_um)[inner(frames.truth)]
    assert np.median(error) < 0.2 * frames.truth.z_um.max()  # near lights are not what the paper assumes


def test_a_press_without_a_ball_is_left_out_and_named_in_the_report(results: Path) -> None:
    report = json.loads((results / "calibration" / "report.json").read_text())
    empty = report["presses"][9]
    assert (empty["name"], empty["image"], empty["balls"]) == ("press-09", "flat.png", [])
    assert empty["fault"].startswith("shows no ball of radius")
    assert any(note.startswith("press-09 (flat.png) shows no ball") for note in report["notes"])


def test_presses_that_all_lack_a_ball_are_refused(
    frames: Frames, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = frames.copy(tmp_path / "set")
    flat = cv2.imread(str(path.parent / "flat.png"), cv2.IMREAD_UNCHANGED)
    for name in set(re.findall(r"press\d.png", path.read_text())):
        cv2.imwrite(str(path.parent / name), np.roll(flat, int(name[5]) + 1, axis=0))
    sentence = refusal(capsys, ["reconstruct", str(path), "--out", str(tmp_path / "out")])
    assert "0 usable balls in 10 calibration presses (press-00 (press0.png), press-01 (press1.png), " in sentence
    assert sentence.count("no ball of radius") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("radius", ["1e-6", "1e6"])
def test_a_ball_of_an_impossible_radius_is_refused(
    frames: Frames, tmp_path: Path, capsys: pytest.CaptureFixture[str], radius: str
) -> None:
    path = frames.copy(tmp_path / "set")
    path.write_text(path.read_text().replace("ball_radius_mm = 3.0", f"ball_radius_mm = {radius}"))
    sentence = refusal(capsys, ["reconstruct", str(path), "--out", str(tmp_path / "out")])
    assert "press-00 (press0.png): " in sentence
    assert "check the ball's radius and the pixel pitch" in sentence


def test_bad_arguments_and_files_are_refused_in_one_sentence(
    frames: Frames, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = frames.copy(tmp_path / "set")
    out = ["--out", str(tmp_path / "out")]
    assert "no-such.toml" in refusal(capsys, ["reconstruct", str(tmp_path / "no-such.toml"), *out])
    assert "frame set" in refusal(capsys, ["reconstruct", *out])
    assert "--out DIR, or --library" in refusal(capsys, ["reconstruct", str(path)])
    assert "are for --watch" in refusal(capsys, ["reconstruct", str(path), *out, "--recipe", "recipe.toml"])
    assert "are for --watch" in refusal(capsys, ["reconstruct", str(path), *out, "--once"])
    for option in (["--force"], ["--detail", "raw"], ["--method", "direct"], ["--s-filter-um", "30"], ["--json"]):
        sentence = refusal(capsys, ["reconstruct", "--watch", "--library", str(tmp_path), *option])
        assert sentence.startswith("retrosync: --watch is for a whole library"), option
    assert "has no scan moon: name one of sphere" in refusal(capsys, ["reconstruct", str(path), "moon", *out])
    data = (path.parent / "press2.png").read_bytes()
    (path.parent / "press2.png").write_bytes(data[: len(data) // 2])
    assert "press2.png" in refusal(capsys, ["reconstruct", str(path), *out])
    assert not (tmp_path / "out").exists()


def test_an_unknown_option_ends_with_code_2_and_no_traceback(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["reconstruct", "x.toml", "--out", "y", "--method", "magic"]) == 2
    assert "Traceback" not in capsys.readouterr().err


def test_results_that_cannot_be_written_are_refused(
    frames: Frames, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = frames.copy(tmp_path / "set")
    (tmp_path / "out").write_text("in the way")
    sentence = refusal(capsys, ["reconstruct", str(path), "--out", str(tmp_path / "out")])
    assert f"cannot be written: {tmp_path / 'out'} is no folder" in sentence
    assert leftovers(tmp_path) == []


def test_a_folder_of_the_users_own_is_never_replaced(
    frames: Frames, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = frames.copy(tmp_path / "set")
    mine = path.parent / "calibration" / "notes.txt"
    mine.parent.mkdir()
    mine.write_text("keep")
    assert "other files than results" in refusal(capsys, ["reconstruct", str(path), "--out", str(path.parent)])
    assert mine.read_text() == "keep"


@pytest.mark.parametrize(("name", "word"), [("black", "is black"), ("bright", "is saturated")])
def test_a_reference_that_is_black_or_saturated_is_refused(
    frames: Frames, tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, word: str
) -> None:
    path = frames.copy(tmp_path / "set")
    path.write_text(path.read_text().replace("flat.png", f"{name}.png"))
    assert f"the reference {word}" in refusal(capsys, ["reconstruct", str(path), "--out", str(tmp_path / "out")])


def pretend_another_version_wrote(folder: Path) -> None:
    """Results of a version whose heights were 2.5 µm higher at one pixel and missing at another."""
    old = folder.with_name(folder.name + "-old")
    folder.rename(old)
    record = json.loads((old / "result.json").read_text())
    (old / "result.json").write_text(json.dumps(record | {"program": "retrograph 0.0.1"}))
    height = tifffile.imread(old / "height_um.tif")
    height[10, 10] += 2.5
    height[20, 20] = np.nan
    tifffile.imwrite(old / "height_um.tif", height)


def test_from_card_to_library_to_results(
    calibrated_root: Path, small_twin: BoardProfile, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    card, library = tmp_path / "card", tmp_path / "library"
    shutil.copytree(calibrated_root, card)
    bench = build(small_twin, VirtualClock())
    with twin_hardware(bench) as hardware:
        scanner = Scanner(hardware, BundleStore(card, hardware.clock, boot_id="b0075e20"))
        hardware.operator.ask(PressObject("coin"))
        hardware.button.wait_for_press(None)
        scan = scanner.scan(Annotations()).bundle
        truth = bench.truth()
    assert main(["pull", str(card), "--library", str(library)]) == 0
    assert main(["pull", str(card), "--library", str(library)]) == 0
    assert "0 copied and verified, 2 already there" in capsys.readouterr().out
    assert main(["reconstruct", "--library", str(library)]) == 0
    (folder,) = (library / "scans" / scan.scan_id / "results").iterdir()
    assert {path.name for path in folder.iterdir()} == RESULT_FILES
    height = tifffile.imread(folder / "height_um.tif")
    error = np.abs(height - truth.z_um)[truth.contact]
    assert np.median(error) < 0.1 * truth.z_um.max()
    raw = library / "scans" / scan.scan_id / "raw.tif"
    raw.write_bytes(raw.read_bytes()[:-100])
    assert "raw.tif" in refusal(capsys, ["reconstruct", "--library", str(library), scan.scan_id])


def test_the_same_work_again_gives_the_same_bits_and_changes_are_said(
    calibrated_root: Path,
    calibrator: Calibrator,
    small_twin: BoardProfile,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    root = tmp_path / "library"
    shutil.copytree(calibrated_root, root)
    with twin_hardware(build(small_twin, VirtualClock())) as hardware:
        scanner = Scanner(hardware, BundleStore(root, hardware.clock, boot_id="b0075e21"))
        hardware.operator.ask(PressObject("coin"))
        hardware.button.wait_for_press(None)
        scan = scanner.scan(Annotations()).bundle
    job = LibraryReconstructor(Library(root), calibrator=calibrator)
    _, folder = job.run(scan)
    assert run(lambda: reproduce_results(Library(root), job=job)) == 0
    assert "1 identical, 0 not as expected" in capsys.readouterr().out
    pretend_another_version_wrote(folder)
    assert run(lambda: reproduce_results(Library(root), job=job)) == 0
    said = capsys.readouterr().out
    assert "height_um.tif: differs by 0 um (median) and 2.5 um at most; 1 pixels changed validity" in said
    assert {path.name for path in folder.parent.iterdir()} == {folder.name, folder.name + "-old"}
    same = folder.with_name(folder.name + "-same")
    shutil.copytree(folder, same)
    assert compare(same, folder) == []
    (same / "slope_p.tif").unlink()
    assert compare(same, folder) == ["slope_p.tif is missing in the stored results"]
    assert leftovers(root) == []


def test_a_library_that_cannot_be_written_is_refused_before_any_work(
    tmp_path: Path,
    publish_scan: Callable[[BundleStore], ScanBundle],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    publish_scan(BundleStore(tmp_path, VirtualClock(), boot_id="b0071d00"))
    monkeypatch.setattr("os.access", lambda *_: False)
    assert "is not yours to write" in refusal(capsys, ["reconstruct", "--library", str(tmp_path)])


def test_an_empty_library_and_a_missing_card_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "there is no library" in refusal(capsys, ["reconstruct", "--library", str(tmp_path / "library")])
    assert "nowhere" in refusal(capsys, ["pull", str(tmp_path / "nowhere"), "--library", str(tmp_path / "lib")])


def test_a_reader_that_has_gone_is_no_traceback(calibrated_root: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "host_sync", "pull", str(calibrated_root), "--library", str(tmp_path / "library")]
    with running(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as ran:
        assert ran.stdout is not None
        assert ran.stderr is not None
        ran.stdout.close()
        error = ran.stderr.read()
    assert ran.returncode in {1, 141}
    assert "Traceback" not in error


def test_a_frame_that_was_turned_is_refused_or_kept_with_its_warning(
    frames: Frames, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "turned"
    shutil.copytree(frames.folder, folder)
    picture = folder / "sphere.png"
    cv2.imwrite(str(picture), cv2.imread(str(picture), cv2.IMREAD_UNCHANGED)[::-1, ::-1])
    out = tmp_path / "out"
    command = ["reconstruct", str(folder / "frameset.toml"), "--out", str(out), "sphere"]
    assert main(command) == 2
    assert "turned by 180 degrees" in capsys.readouterr().err
    assert not (out / "sphere").exists()
    assert main([*command, "--force"]) == 0
    record = json.loads((out / "sphere" / "result.json").read_text())
    assert "turned by 180 degrees" in record["warnings"][0]


def test_a_doubt_of_many_scans_stands_once(capsys: pytest.CaptureFixture[str]) -> None:
    outcomes = [ScanOutcome(f"scan-{number}", Path(), ("failed calibration",)) for number in range(4)]
    outcomes += [ScanOutcome("scan-4", Path(), ("no zero",)), ScanOutcome("scan-5", reason="it is blurred")]
    print_outcomes(outcomes)
    assert capsys.readouterr().err.splitlines() == [
        "retrosync: scan-5: it is blurred",
        "retrosync: scan-0, scan-1, scan-2 and 1 more: doubt: failed calibration",
        "retrosync: scan-4: doubt: no zero",
    ]
