"""The drivers that the conformance suites run over: a real driver joins by adding a factory here."""

from collections.abc import Callable

import pytest

from hal.hardware import Hardware
from hal.twin.bench import Bench, build
from hal.twin.hardware import twin_hardware
from hal.twin.wired.hardware import wired_hardware

Factory = Callable[[Bench], Hardware]

DRIVERS: dict[str, Factory] = {
    "twin": twin_hardware,
    "picamera2 + PCA9955B + gpiod": lambda bench: wired_hardware(bench, "PCA9955B").hardware,
    "picamera2 + TLC59116 + gpiod": lambda bench: wired_hardware(bench, "TLC59116").hardware,
}


@pytest.fixture(params=sorted(DRIVERS))
def driver(request: pytest.FixtureRequest, bench: Bench) -> Hardware:
    """Hardware that is not yet entered."""
    return DRIVERS[request.param](build(bench.profile, bench.clock))
