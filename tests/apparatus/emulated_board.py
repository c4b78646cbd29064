"""A complete emulated board in one simulated world: the real drivers on emulated libraries."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import msgspec
from fake_gpio import FakeGpioLine
from fake_i2c import FakeI2cBus
from fake_picamera2 import FakePicamera2
from gauge_model import Max17048Model

from hal.board_profile import (
    BoardProfile,
    ButtonConfig,
    FuelGaugeConfig,
    IndicatorConfig,
    LibcameraConfig,
    LightDriverConfig,
    PowerConfig,
)
from hal.drivers.board_hardware import Machine, board_hardware
from hal.errors import LightError
from hal.hardware import Hardware
from hal.simulator.bench import SimulatedScene, build
from hal.simulator.hardware import led_model, lighting
from hal.simulator.led_chips import LedDriverModel
from hal.simulator.operator import TwinOperator

Chip = Literal["PCA9955B", "TLC59116"]
CAMERA_ID: Final = "/base/soc/i2c0mux/i2c@1/imx296@1a"
LIGHTS_AT: Final = 0x15
GAUGE_AT: Final = 0x36
SPARE_CHANNEL: Final = 15
REFERENCE_OHM: Final = {"PCA9955B": 2400.0, "TLC59116": 1000.0}
ENABLE_LINE: Final = {"PCA9955B": 6, "TLC59116": 23}
LED_MAX_MA: Final = 25.0
LED_CHANNELS: Final = ((0, 1), (4, 5), (9,))


@dataclass(slots=True)
class Firmware:
    """Throttle flags of the firmware."""

    throttled: str = "0\n"

    def read(self) -> str:
        """The throttle bits as text."""
        return self.throttled


class FakeGateLine:
    """See `hal.drivers.chip_lights.SwitchedLine`: a line at the LED driver's OE or RESET, with a pull towards dark."""

    def __init__(self, leds: LedDriverModel) -> None:
        self._leds = leds
        self.broken = False
        self.release()

    def switch(self, on: bool) -> None:
        """Drive the pin."""
        if self.broken:
            raise LightError("the light driver's enable cannot be driven: check light_driver.enable_line")
        self._leds.enable(on)

    def release(self) -> None:
        """Leave the pin to its pull."""
        self._leds.enable(False)


@dataclass(frozen=True, slots=True)
class EmulatedBoard:
    """A board and everything below its drivers, to inspect and to break."""

    bench: SimulatedScene
    hardware: Hardware
    leds: LedDriverModel
    gauge: Max17048Model
    wire: FakeI2cBus
    cameras: FakePicamera2
    line: FakeGpioLine
    firmware: Firmware
    gate: FakeGateLine


def emulated_profile(profile: BoardProfile, chip: Chip) -> BoardProfile:
    """The twin's profile as that of a real board: every table that drivers need, in the same world."""
    lights = tuple(
        msgspec.structs.replace(light, channels=channels, max_ma=LED_MAX_MA)
        for light, channels in zip(profile.lights, LED_CHANNELS, strict=True)
    )
    return msgspec.structs.replace(
        profile,
        driver="picamera2",
        lights=lights,
        libcamera=LibcameraConfig(
            camera_id="imx296@1a",
            raw_bits=12,
            sensor_bits=12,
            frame_period_us=profile.twin.frame_period_us if profile.twin else 16_667.0,
            aiming_columns=160,
            aiming_rows=120,
        ),
        light_driver=LightDriverConfig(chip=chip, bus=1, address=LIGHTS_AT, reference_ohm=REFERENCE_OHM[chip]),
        button=ButtonConfig(chip_label="pinctrl-bcm2711", line=17),
        indicator=IndicatorConfig(channel=SPARE_CHANNEL),
        power=PowerConfig(fuel_gauge=FuelGaugeConfig(chip="MAX17048", bus=1)),
    )


def emulated_hardware(bench: SimulatedScene, chip: Chip) -> EmulatedBoard:
    """The board in a new world with the profile, clock and seed of `bench`."""
    profile = emulated_profile(bench.profile, chip)
    wired = LightDriverConfig(
        chip=chip, bus=1, address=LIGHTS_AT, reference_ohm=REFERENCE_OHM[chip], enable_line=ENABLE_LINE[chip]
    )
    world = build(msgspec.structs.replace(profile, light_driver=wired), bench.clock, bench.seed)
    leds = led_model(chip, REFERENCE_OHM[chip])
    leds.changed = lighting(world, leds)
    gate = FakeGateLine(leds)
    gauge = Max17048Model()
    wire = FakeI2cBus({LIGHTS_AT: leds, GAUGE_AT: gauge}, world.clock)
    cameras, line, firmware = FakePicamera2(world, CAMERA_ID), FakeGpioLine(world), Firmware()
    machine = Machine(
        load_cameras=lambda: cameras,
        open_bus=wire.open,
        open_input=lambda *_place: lambda: line,
        throttled_file=firmware.read,
        gate=lambda *_place: gate,
    )
    hardware = board_hardware(world.profile, world.clock, machine, TwinOperator(world))
    return EmulatedBoard(world, hardware, leds, gauge, wire, cameras, line, firmware, gate)
