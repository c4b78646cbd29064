"""The twin as hardware: the devices of one bench."""

from __future__ import annotations

from hal.hardware import Hardware
from hal.twin.bench import Bench
from hal.twin.button import TwinButton
from hal.twin.camera import TwinCamera
from hal.twin.indicator import TwinIndicator
from hal.twin.lights import TwinLights
from hal.twin.operator import TwinOperator
from hal.twin.power import TwinPower


def twin_hardware(bench: Bench) -> Hardware:
    """Camera, lights, button and operator of one simulated world."""
    return Hardware(
        profile=bench.profile,
        camera=TwinCamera(bench),
        lights=TwinLights(bench),
        button=TwinButton(bench),
        indicator=TwinIndicator(bench),
        power=TwinPower(bench),
        operator=TwinOperator(bench),
        clock=bench.clock,
    )
