"""`retroscan focus`: its figure is largest where the lens is sharpest, and it ends as asked."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest

from device.acquisition.capture import CaptureSettings, capture
from device.cli.main import main
from device.imaging.frame_measures import focus_figure
from hal.board_profile import BoardProfile
from hal.clock import VirtualClock
from hal.frame import CameraSettings, RawFrame
from hal.interfaces import PressObject
from hal.profile_tables import LensConfig
from hal.simulator.bench import build
from hal.simulator.hardware import twin_hardware


def figure_with(profile: BoardProfile, point_spread_px: float) -> float:
    twin = msgspec.structs.replace(profile.twin, point_spread_px=point_spread_px)  # type: ignore[type-var]
    bench = build(msgspec.structs.replace(profile, twin=twin), VirtualClock())
    with twin_hardware(bench) as hardware:
        hardware.operator.ask(PressObject("coin"))
        hardware.button.wait_for_press(None)
        return focus_figure(capture(hardware, CaptureSettings.of_board(hardware)))


def test_the_sharper_the_lens_the_larger_the_figure(small_twin: BoardProfile) -> None:
    figures = [figure_with(small_twin, blur) for blur in (0.5, 1.0, 2.0, 4.0)]
    assert figures == sorted(figures, reverse=True)
    assert figures[0] > 1.2 * figures[2]


def test_the_figure_is_largest_with_the_coins_face_in_focus(small_twin: BoardProfile) -> None:
    """The lens stands at f/1.4 and its focus ring goes through the depth at which the coin's relief lies."""
    figures = {}
    for focus_mm in (-2.0, -1.0, 0.0, 0.4, 1.5, 2.5):
        lens = LensConfig(
            focal_mm=25.0, f_number=1.4, pixel_um=0.3 * small_twin.sensor.pixel_pitch_um, focus_mm=focus_mm
        )
        figures[focus_mm] = figure_with(msgspec.structs.replace(small_twin, lens=lens), 0.0)
    order = [figures[focus_mm] for focus_mm in sorted(figures)]
    best = order.index(max(order))
    assert sorted(figures)[best] in {0.0, 0.4}
    assert order[: best + 1] == sorted(order[: best + 1])
    assert order[best:] == sorted(order[best:], reverse=True)
    assert order[best] > 1.2 * max(order[0], order[-1])


def test_darkness_has_no_focus() -> None:
    dark = RawFrame(np.full((32, 48), 256, np.uint16), "RGGB", 256.0, 4095.0, CameraSettings(2000.0, 1.0), 0)
    assert focus_figure(dark) == 0.0


def test_the_command_shows_figure_and_best(small_board: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--board", str(small_board), "focus", "--frames", "3"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 4
    figures, bests = zip(*((float(line.split()[0]), float(line.split()[2])) for line in lines[1:]), strict=True)
    assert bests[-1] == max(figures) > 0.0
    assert all("Turn the focus ring slowly" in line for line in lines[1:])


def test_no_number_of_frames_is_refused(small_board: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--board", str(small_board), "focus", "--frames", "0"]) == 2
    assert "is not a count" in capsys.readouterr().err
