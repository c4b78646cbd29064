"""The paper's figures from the command line, of a library's calibration; a held-out ball is judged as it should be."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from host_sync.calibration.calibrate import Calibration
from host_sync.calibration.frames import CalibrationFrames
from host_sync.calibration_file.calibrator import Calibrator
from host_sync.calibration_file.inputs import CalibrationCache
from host_sync.cli.main import main
from host_sync.evaluation import BallError, ball_error_figure, frames_to_draw, held_out_ball_errors
from host_sync.library.library import Library
from host_sync.offload.pull import pull
from host_sync.offload.source import DirectorySource

NAMES = ("reflectance-maps", "ambiguous-bins", "ball-errors")


@pytest.fixture(scope="module")
def library(calibrated_root: Path, tmp_path_factory: pytest.TempPathFactory) -> Library:
    library = Library(tmp_path_factory.mktemp("library"))
    assert pull(DirectorySource(calibrated_root), library).complete
    return library


@pytest.fixture(scope="module")
def drawn(library: Library, calibration_cache: CalibrationCache) -> tuple[CalibrationFrames, Calibration]:
    return frames_to_draw(None, library, Calibrator(calibration_cache, paper=True))


@pytest.fixture(scope="module")
def errors(drawn: tuple[CalibrationFrames, Calibration]) -> tuple[BallError, ...]:
    return held_out_ball_errors(*drawn)


@pytest.mark.slow
def test_every_figure_is_written_in_every_format(library: Library, tmp_path: Path) -> None:
    out = tmp_path / "figures"
    assert main(["paper-figures", "--library", str(library.root), "--out", str(out), "--format", "png", "svg"]) == 0
    assert {path.name for path in out.iterdir()} == {f"{name}.{kind}" for name in NAMES for kind in ("png", "svg")}
    for name in NAMES:
        picture = cv2.imread(str(out / f"{name}.png"))
        assert picture is not None
        assert picture.std() > 10.0


@pytest.mark.slow
def test_a_held_out_ball_is_judged_by_both_methods(errors: tuple[BallError, ...]) -> None:
    assert [error.method for error in errors] == ["direct", "paper"]
    direct, paper = (float(error.angle_deg[error.inner].mean()) for error in errors)
    assert direct < 2.0
    assert direct < paper
    for error in errors:
        assert error.radius_um == pytest.approx(3000.0, rel=0.02)
        assert abs(float(np.median(error.height_um[error.inner]))) < 1e-3
        assert (error.inside | ~error.inner).all()
    assert float(errors[0].height_percent[errors[0].inner].mean()) < 2.0


@pytest.mark.slow
def test_both_methods_are_drawn_side_by_side(errors: tuple[BallError, ...]) -> None:
    titles = [axes.get_title() for axes in ball_error_figure(errors).axes if axes.get_title()]
    assert len(titles) == 4
    assert [title.split(":")[0] for title in titles[2:]] == ["normal", "normal"]


@pytest.mark.slow
def test_the_ball_that_is_judged_taught_nothing(drawn: tuple[CalibrationFrames, Calibration]) -> None:
    frames, calibration = drawn
    held = calibration.presses[3].balls[0]
    kept = [ball for press in frames.without(calibration, 3, held).presses for ball in press.balls or ()]
    assert held not in kept
    assert len(kept) == sum(len(press.balls) for press in calibration.presses) - 1


def test_a_library_without_calibrations_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["paper-figures", "--library", str(tmp_path), "--out", str(tmp_path / "out")]) == 2
    assert "holds no calibration" in capsys.readouterr().err
    assert main(["paper-figures", "--out", str(tmp_path / "out")]) == 2
    assert "name the frame set" in capsys.readouterr().err
