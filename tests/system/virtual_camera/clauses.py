"""What the camera driver does with a real libcamera whose camera is virtual: runs inside the virtual board."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from picamera2 import Picamera2

from hal.drivers.camera_picamera2 import PicameraCamera
from hal.errors import CameraError
from hal.hardware import Hardware


def retroscan(board: Path, *command: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "device", "--board", board, *command],
        capture_output=True, text=True, check=False, timeout=600,
    )  # fmt: skip


def test_the_camera_is_the_one_that_was_meant_though_another_is_listed_first(driver: Hardware) -> None:
    assert [info["Id"] for info in Picamera2.global_camera_info()] == ["Virtual1", "Virtual0"]
    with driver.camera:
        opened = driver.camera._pipeline.guarded("tell its id", lambda camera: camera.camera.id)
        assert opened == driver.camera.camera_id == "Virtual0"
        assert driver.camera.aiming_view(5.0).shape == (480, 640)


def test_the_view_is_the_pattern_that_the_pipeline_draws(driver: Hardware) -> None:
    with driver.camera:
        view = driver.camera.aiming_view(5.0)
    bars = view[240].reshape(8, 80)
    assert bars[:, 10:70].std(axis=1).max() < 4.0
    assert bars[:, 40].max() - bars[:, 40].min() > 100


def test_it_opens_again_after_it_was_closed(driver: Hardware) -> None:
    for _ in range(3):
        with driver.camera:
            driver.camera.aiming_view(5.0)


@pytest.mark.parametrize(
    ("camera_id", "reason"),
    [
        ("imx296", "is not there: cameras are Virtual1, Virtual0"),
        ("Virtual0", "camera Virtual0 grants no raw stream, as a USB or virtual camera"),
    ],
)
def test_the_driver_refuses_by_name(plain: Callable[[str], PicameraCamera], camera_id: str, reason: str) -> None:
    with pytest.raises(CameraError, match=reason), plain(camera_id):
        pass


def test_the_scanner_refuses_it_by_name(board_of_virtual_camera: Path, tmp_path: Path) -> None:
    scanned = retroscan(board_of_virtual_camera, "--store", str(tmp_path / "store"), "scan")
    assert scanned.returncode == 3
    assert scanned.stderr == (
        "retroscan: camera Virtual0 grants no raw stream, as a USB or virtual camera: "
        "use a sensor on the board's own connector\n"
    )
    assert not (tmp_path / "store").exists()


def test_the_self_test_blames_the_camera_and_no_other_part(board_of_virtual_camera: Path) -> None:
    walked = retroscan(board_of_virtual_camera, "selftest")
    states = dict(line.split(":")[0].split(maxsplit=1)[::-1] for line in walked.stdout.splitlines())
    assert walked.returncode == 3
    assert states.pop("camera") == "failed"
    assert {states.pop(f"light {name}") for name in ("red", "green", "blue")} == {"skipped"}
    assert set(states.values()) == {"ok"}
