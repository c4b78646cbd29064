"""The drivers that the conformance suites run over: a real driver joins by adding a factory here.

With `-m board` and RETROGRAPH_BOARD=<profile> they run on the hardware of this machine; somebody must push its button
when a test of it waits.
"""

import os
from collections.abc import Callable

import pytest

from hal.board_profile import load_board_profile
from hal.hardware import Hardware, open_hardware
from hal.twin.bench import Bench, build
from hal.twin.hardware import twin_hardware
from hal.twin.wired.hardware import wired_hardware

Factory = Callable[[Bench], Hardware]


def _this_board(_bench: Bench) -> Hardware:
    name = os.environ.get("RETROGRAPH_BOARD")
    if not name:
        pytest.skip("RETROGRAPH_BOARD names no board profile of this machine")
    return open_hardware(load_board_profile(name))


DRIVERS: dict[str, Factory] = {
    "twin": twin_hardware,
    "picamera2 + PCA9955B + gpiod": lambda bench: wired_hardware(bench, "PCA9955B").hardware,
    "picamera2 + TLC59116 + gpiod": lambda bench: wired_hardware(bench, "TLC59116").hardware,
}
BOARD = pytest.param(_this_board, id="board", marks=pytest.mark.board)


@pytest.fixture(params=[*(pytest.param(factory, id=name) for name, factory in DRIVERS.items()), BOARD])
def driver(request: pytest.FixtureRequest, bench: Bench) -> Hardware:
    """Hardware that is not yet entered."""
    factory: Factory = request.param
    return factory(build(bench.profile, bench.clock))
