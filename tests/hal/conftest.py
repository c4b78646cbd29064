"""A twin of the reference field at a quarter of its resolution, so that a press takes milliseconds."""

import msgspec
import pytest

from hal.board_profile import BoardProfile, load_board_profile
from hal.clock import VirtualClock
from hal.hardware import Hardware
from hal.twin.bench import Bench, build
from hal.twin.hardware import twin_hardware


@pytest.fixture
def profile() -> BoardProfile:
    reference = load_board_profile("twin")
    sensor = msgspec.structs.replace(reference.sensor, columns=364, rows=272, pixel_pitch_um=48.0)
    return msgspec.structs.replace(reference, sensor=sensor)


@pytest.fixture
def bench(profile: BoardProfile) -> Bench:
    return build(profile, VirtualClock())


@pytest.fixture
def hardware(bench: Bench) -> Hardware:
    return twin_hardware(bench)
