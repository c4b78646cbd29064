"""`retrosync video` from its command line, and how commands end when they are interrupted or not watched."""

from __future__ import annotations

import json
import os
import shutil
import signal
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import tifffile

from device.acquisition.precise_capture import MEMORY_FRACTION
from device.acquisition.scanner import Scanner
from device.bundles.calibration import CalibrationBundle
from device.bundles.raw_frame import write_raw
from device.bundles.scan import Annotations
from device.imaging.flat_field import MOVIE_BINNING, demosaic, make_flat_field
from device.inverse_map.model import MODEL_FILE, read_model
from device.store.registry_file import read_active
from device.store.store import BundleStore
from hal.hardware import Hardware
from hal.interfaces import PressObject
from hal.simulator.bench import SimulatedScene
from host_sync.calibration_file.calibrator import Calibrator
from host_sync.cli.main import main, run
from host_sync.render.picture_file import plays_in_browser
from host_sync.viewer.entry import result_entry
from tests.apparatus.deepening_press import press_deeper
from tests.apparatus.plain_calibration import plain_calibration


@pytest.fixture
def sequence(calibrated_root: Path, tmp_path: Path) -> Path:
    """A folder of raw frames: the untouched skin, a ball, and half a file."""
    bundle = read_active(calibrated_root)
    folder = tmp_path / "[red]press"
    folder.mkdir()
    write_raw(folder / "frame-9.tif", bundle.reference())
    write_raw(folder / "frame-10.tif", bundle.press_frame(bundle.record.presses[0]))
    torn = (folder / "frame-9.tif").read_bytes()
    (folder / "frame-11.tif").write_bytes(torn[: len(torn) // 2])
    return folder


def as_the_device_fitted_it(bundle: CalibrationBundle) -> SimpleNamespace:
    """A calibration in a moment: the workstation's own, from the same frames, takes half a minute and its own tests."""
    model = read_model(bundle.path(MODEL_FILE))
    flat_field = make_flat_field(demosaic(bundle.reference()))
    calibration = plain_calibration(flat_field, model, bundle.record.pixel_pitch_um)
    return SimpleNamespace(
        calibration=calibration, facts=SimpleNamespace(encoding=None, full_scale=None, pixel_shape=1.0)
    )


@pytest.fixture
def arguments(calibrated_root: Path, sequence: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The command of the sequence under the beginning of a calibration's id, without `--out`."""
    monkeypatch.setattr(Calibrator, "of_bundle", lambda _, bundle: as_the_device_fitted_it(bundle))
    calibration_id = read_active(calibrated_root).calibration_id[:-1]
    return ["video", str(sequence), "--calibration", calibration_id, "--library", str(calibrated_root)]


def test_a_folder_of_raw_frames_under_a_librarys_calibration(
    arguments: list[str], calibrated_root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bundle = read_active(calibrated_root)
    out = tmp_path / "out"
    assert main([*arguments, "--out", str(out), "--rate-hz", "10"]) == 1
    printed = capsys.readouterr()
    doubt, said = printed.out.splitlines()
    assert doubt == "doubt: uncovered sector: balls of the calibration do not cover middle of the frame"
    assert said.startswith(f"2 of 3 frames into {out}: ")
    assert "heights/s" in printed.out
    assert printed.err.count("\n") == 1
    assert "frame-11.tif" in printed.err
    assert "[red]press" in printed.err
    movies = {"relief.mp4", "relief.gif"} | (set() if plays_in_browser() else {"relief.webp"})
    written = {"heights_um.tif", "contact.csv", "contact.png", "result.json"}
    assert {path.name for path in out.iterdir()} == written | movies
    rest, ball, torn = tifffile.imread(out / "heights_um.tif")
    (place, *_) = bundle.record.presses[0].balls
    around = np.s_[round(place.row) - 3 : round(place.row) + 4, round(place.column) - 3 : round(place.column) + 4]
    assert np.abs(np.nanmedian(rest)) < 10.0
    assert np.nanmean(ball[around]) > 100.0
    assert np.isnan(torn).all()
    record = json.loads((out / "result.json").read_text())
    assert record["frames"][1]["peak_um"] > 100.0 > record["frames"][0]["peak_um"]
    assert record["frames"][2]["time_s"] == pytest.approx(0.2)
    (stated,) = result_entry(out).doubts
    assert stated == doubt.removeprefix("doubt: ")


def leave_room_for_frames(count: int, hardware: Hardware, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the machine report free memory for a movie of so many frames."""
    sensor = hardware.profile.sensor
    free = round(count * 2 * sensor.columns * sensor.rows / MOVIE_BINNING**2 / MEMORY_FRACTION)
    monkeypatch.setattr(os, "sysconf", {"SC_AVPHYS_PAGES": free, "SC_PAGE_SIZE": 1}.__getitem__)


def test_a_scans_movie_shows_the_press_deepen(
    calibrated: BundleStore, bench: SimulatedScene, hardware: Hardware, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Calibrator, "of_bundle", lambda _, bundle: as_the_device_fitted_it(bundle))
    with hardware:
        scanner = Scanner(hardware, calibrated)
        leave_room_for_frames(24, hardware, monkeypatch)
        press_deeper(bench, hardware, within_s=0.3)
        bundle = scanner.scan(Annotations(part="bolt"), mode="movie").bundle
    out = tmp_path / "out"
    assert main(["video", "bolt", "--library", str(calibrated.root), "--out", str(out), "--no-mp4", "--no-gif"]) == 0
    frames = json.loads((out / "result.json").read_text())["frames"]
    assert bundle.record.movie is not None
    assert len(frames) == len(bundle.record.movie.frames) == 24
    peaks_um = [frame["peak_um"] for frame in frames]
    assert peaks_um[-1] > 2.0 * peaks_um[len(frames) // 4] > 0.0
    assert frames[-1]["contact_share"] > frames[0]["contact_share"]
    assert frames[-1]["time_s"] == pytest.approx(bundle.record.movie.frames[-1].at_ms / 1e3, rel=0.02)


def test_a_scan_without_a_movie_is_refused(
    calibrated: BundleStore, hardware: Hardware, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with hardware:
        hardware.operator.ask(PressObject("coin"))
        hardware.button.wait_for_press(None)
        Scanner(hardware, calibrated).scan(Annotations(part="bolt"))
    assert main(["video", "bolt", "--library", str(calibrated.root), "--out", str(tmp_path / "out")]) == 2
    assert "holds no movie" in capsys.readouterr().err


def test_bad_input_is_refused_in_one_sentence(
    calibrated_root: Path, sequence: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "empty").mkdir()
    calibration = str(read_active(calibrated_root).directory)
    out = ["--out", str(tmp_path / "out")]
    for arguments, words in (
        (["video", str(tmp_path / "empty"), "--calibration", calibration, *out], "holds no PNG"),
        (["video", str(sequence), "--calibration", str(tmp_path / "no.toml"), *out], "no.toml"),
        (["video", str(sequence), "--calibration", str(tmp_path / "empty"), *out], "calibration.json"),
        (["video", str(sequence), "--calibration", calibration, *out, "--rate-hz", "0"], "is not a rate"),
    ):
        assert main(arguments) == 2
        error = capsys.readouterr().err
        assert error.startswith("retrosync: ")
        assert words in error
        assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("place", ["/", "", "."])
def test_a_place_that_is_no_folder_of_its_own_is_refused_before_any_work(
    place: str,
    calibrated_root: Path,
    sequence: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(sequence)
    arguments = ["video", str(sequence), "--calibration", "x", "--library", str(calibrated_root)]
    assert main([*arguments, "--out", place]) == 2
    assert "cannot be written" in capsys.readouterr().err


def test_a_frames_name_that_is_no_text_neither_ends_the_run_nor_moves_the_terminal(
    arguments: list[str], sequence: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (sequence / "frame-11.tif").rename(sequence / "frame-\udcff\x1b[2J.tif")
    arguments += ["--no-mp4", "--no-gif"]
    assert main([*arguments, "--out", str(tmp_path / "out")]) == 1
    printed = capsys.readouterr()
    assert printed.out.splitlines()[-1].startswith("2 of 3 frames")
    assert "\x1b" not in printed.err
    assert (tmp_path / "out" / "result.json").is_file()


def test_an_interrupted_command_says_so_and_ends_with_130(capsys: pytest.CaptureFixture[str]) -> None:
    def interrupt() -> int:
        raise KeyboardInterrupt

    assert run(interrupt) == 130
    assert capsys.readouterr().err == "retrosync: stopped: unfinished results are not kept\n"


def test_a_command_that_is_asked_to_end_leaves_nothing_half_written(
    arguments: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    before = signal.getsignal(signal.SIGTERM)
    begun: list[Path] = []

    def end(*_arguments: object) -> list[str]:
        begun.extend(tmp_path.glob(".out*"))
        os.kill(os.getpid(), signal.SIGTERM)
        return []

    def calibrate(_: Calibrator, bundle: CalibrationBundle) -> SimpleNamespace:
        calibration = as_the_device_fitted_it(bundle)
        calibration.calibration.frame_model = SimpleNamespace(check=end)  # while the first frame is solved
        return calibration

    monkeypatch.setattr(Calibrator, "of_bundle", calibrate)
    assert main([*arguments, "--out", str(tmp_path / "out")]) == 130
    assert capsys.readouterr().err.endswith("stopped: unfinished results are not kept\n")
    assert begun
    assert not list(tmp_path.glob("*out*"))
    assert signal.getsignal(signal.SIGTERM) is before


def test_paths_are_printed_as_they_are_and_nobody_watching_sees_no_blank_line(
    calibrated_root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    library = tmp_path / "[red]lib" / ("long-" * 30)
    card = tmp_path / "card"
    shutil.copytree(calibrated_root, card)
    assert main(["pull", str(card), "--library", str(library)]) == 0
    printed = capsys.readouterr()
    assert printed.out.startswith(f"1 copied and verified, 0 already there: {library}\n")
    assert printed.err == ""
