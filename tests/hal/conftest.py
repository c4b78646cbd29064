"""A twin of the reference field at a quarter of its resolution, so that a press takes milliseconds."""

import pytest

from hal.board_profile import BoardProfile
from hal.clock import VirtualClock
from hal.hardware import Hardware
from hal.simulator.bench import SimulatedScene, build
from hal.simulator.hardware import twin_hardware


@pytest.fixture
def profile(small_twin: BoardProfile) -> BoardProfile:
    return small_twin


@pytest.fixture
def bench(profile: BoardProfile) -> SimulatedScene:
    return build(profile, VirtualClock())


@pytest.fixture
def hardware(bench: SimulatedScene) -> Hardware:
    return twin_hardware(bench)
