"""A twin of the reference field at a quarter of its resolution, so that a press takes milliseconds."""

import pytest

from hal.board_profile import BoardProfile
from hal.clock import VirtualClock
from hal.hardware import Hardware
from hal.twin.bench import Bench, build
from hal.twin.hardware import twin_hardware


@pytest.fixture
def profile(small_twin: BoardProfile) -> BoardProfile:
    return small_twin


@pytest.fixture
def bench(profile: BoardProfile) -> Bench:
    return build(profile, VirtualClock())


@pytest.fixture
def hardware(bench: Bench) -> Hardware:
    return twin_hardware(bench)
