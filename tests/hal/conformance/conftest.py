"""The drivers for the conformance suites: a real driver joins by adding a factory here.

With `-m board` and RETROGRAPH_BOARD=<profile> they run on the hardware of this machine; a person must push its button
when a test waits for that.
"""

import os
from collections.abc import Callable

import pytest
from emulated_board import emulated_hardware

from hal.board_profile import load_board_profile
from hal.factory import open_hardware
from hal.hardware import Hardware
from hal.simulator.bench import SimulatedScene, build
from hal.simulator.hardware import twin_hardware

Factory = Callable[[SimulatedScene], Hardware]


def _this_board(_bench: SimulatedScene) -> Hardware:
    name = os.environ.get("RETROGRAPH_BOARD")
    if not name:
        pytest.skip("RETROGRAPH_BOARD names no board profile of this machine")
    return open_hardware(load_board_profile(name))


DRIVERS: dict[str, Factory] = {
    "twin": twin_hardware,
    "picamera2 + PCA9955B + gpiod": lambda bench: emulated_hardware(bench, "PCA9955B").hardware,
    "picamera2 + TLC59116 + gpiod": lambda bench: emulated_hardware(bench, "TLC59116").hardware,
}
BOARD = pytest.param(_this_board, id="board", marks=pytest.mark.board)


@pytest.fixture(params=[*(pytest.param(factory, id=name) for name, factory in DRIVERS.items()), BOARD])
def driver(request: pytest.FixtureRequest, bench: SimulatedScene) -> Hardware:
    """Hardware, not yet entered."""
    factory: Factory = request.param
    return factory(build(bench.profile, bench.clock))
