"""A camera that does not let go, as after a torn ribbon: the program ends, dark, and its service starts it again."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from emulated_board import EmulatedBoard, emulated_hardware
from limits import join

from device.cli.instrument_commands import run_headless
from device.instrument.instrument import Instrument
from device.store.store import BundleStore
from hal.drivers import camera_pipeline
from hal.errors import CameraError, CameraStuck
from hal.simulator.bench import SimulatedScene


@pytest.fixture
def wired(bench: SimulatedScene, monkeypatch: pytest.MonkeyPatch) -> Iterator[EmulatedBoard]:
    """A board whose first camera to be closed hangs until the test is over."""
    monkeypatch.setattr(camera_pipeline, "CLOSING_S", 0.01)
    wired = emulated_hardware(bench, "PCA9955B")
    wired.cameras.faults.hanging_closings = 1
    yield wired
    wired.cameras.let_go.set()


def test_opening_again_says_that_the_program_must_end(wired: EmulatedBoard) -> None:
    camera = wired.hardware.camera
    camera.__enter__()
    with pytest.raises(CameraError, match="does not stop within"):
        camera.__exit__(None, None, None)
    with pytest.raises(CameraStuck, match="start the program again"):
        camera.__enter__()


def test_a_camera_that_lets_go_late_is_opened_again(wired: EmulatedBoard) -> None:
    camera = wired.hardware.camera
    camera.__enter__()
    with pytest.raises(CameraError, match="does not stop within"):
        camera.__exit__(None, None, None)
    wired.cameras.let_go.set()
    for thread in camera._pipeline._closing:  # type: ignore[attr-defined]
        join(thread)
    with camera:
        camera.next_frame(1.0)


def test_a_second_camera_that_does_not_stop_ends_the_program(wired: EmulatedBoard) -> None:
    wired.cameras.faults.hanging_closings = 2
    camera = wired.hardware.camera
    camera.__enter__()
    with pytest.raises(CameraError, match="does not stop within"):
        camera.__exit__(None, None, None)
    wired.cameras.opened = 0  # libcamera hands it out all the same
    camera.__enter__()
    with pytest.raises(CameraStuck):
        camera.__exit__(None, None, None)
    wired.cameras.opened = 2


def test_another_program_that_holds_the_camera_ends_nothing(wired: EmulatedBoard) -> None:
    wired.cameras.faults.in_use = True
    with pytest.raises(CameraError, match="no other program uses it") as caught:
        wired.hardware.camera.__enter__()
    assert not isinstance(caught.value, CameraStuck)


def test_the_instrument_ends_dark_instead_of_trying_for_ever(wired: EmulatedBoard, calibrated: BundleStore) -> None:
    wired.cameras.faults.stalled_openings = 1
    printed: list[str] = []
    turns = iter(range(200))
    with (
        pytest.raises(CameraStuck, match="did not stop and is still held by this program"),
        Instrument(wired.hardware, calibrated) as instrument,
    ):
        run_headless(
            instrument, printed.append, lambda what: printed.append(str(what)), lambda: next(turns, None) is not None
        )
    assert any("delivers no frame" in line for line in printed)
    assert not any(wired.leds.currents_ma())
