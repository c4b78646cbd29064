"""A whole board over one bench: the real drivers, on likenesses of what they stand on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Literal

import msgspec

from hal.board_hardware import Machine, board_hardware
from hal.board_parts import (
    ButtonFacts,
    FuelGaugeFacts,
    IndicatorFacts,
    LibcameraFacts,
    LightDriverFacts,
    PowerFacts,
)
from hal.board_profile import BoardProfile
from hal.hardware import Hardware
from hal.twin.bench import Bench, build
from hal.twin.operator import TwinOperator
from hal.twin.wired.camera_wire import CameraWire
from hal.twin.wired.chip_models import LedDriverModel, Max17048Model, Pca9955bModel, Tlc59116Model
from hal.twin.wired.gpio_wire import ButtonLine
from hal.twin.wired.i2c_wire import I2cWire

Chip = Literal["PCA9955B", "TLC59116"]
CAMERA_ID: Final = "/base/soc/i2c0mux/i2c@1/imx296@1a"
LIGHTS_AT: Final = 0x15
GAUGE_AT: Final = 0x36
SPARE_CHANNEL: Final = 15
LED_CHANNELS: Final = ((0, 1), (4, 5), (9,))


@dataclass(slots=True)
class Firmware:
    """What the firmware says of throttling."""

    throttled: str = "0\n"

    def read(self) -> str:
        """The throttle bits as text."""
        return self.throttled


@dataclass(frozen=True, slots=True)
class Wired:
    """A board and everything below its drivers, to look at and to break."""

    bench: Bench
    hardware: Hardware
    leds: LedDriverModel
    gauge: Max17048Model
    wire: I2cWire
    cameras: CameraWire
    line: ButtonLine
    firmware: Firmware


def wired_profile(profile: BoardProfile, chip: Chip) -> BoardProfile:
    """The twin's profile as a real board's: every table that drivers need, the world kept."""
    lights = tuple(
        msgspec.structs.replace(light, channels=channels)
        for light, channels in zip(profile.lights, LED_CHANNELS, strict=True)
    )
    return msgspec.structs.replace(
        profile,
        driver="picamera2",
        lights=lights,
        libcamera=LibcameraFacts(
            camera_id="imx296@1a",
            raw_bits=12,
            sensor_bits=12,
            frame_period_us=profile.twin.frame_period_us if profile.twin else 16_667.0,
            aiming_columns=160,
            aiming_rows=120,
        ),
        light_driver=LightDriverFacts(chip=chip, bus=1, address=LIGHTS_AT, reference_ohm=1000.0),
        button=ButtonFacts(chip_label="pinctrl-bcm2711", line=17),
        indicator=IndicatorFacts(channel=SPARE_CHANNEL),
        power=PowerFacts(fuel_gauge=FuelGaugeFacts(chip="MAX17048", bus=1)),
    )


def wired_hardware(bench: Bench, chip: Chip) -> Wired:
    """The board over a world like that bench's, with its clock and seed."""
    world = build(wired_profile(bench.profile, chip), bench.clock, bench.seed)
    leds = led_model(chip)
    leds.changed = lighting(world, leds)
    gauge = Max17048Model()
    wire = I2cWire({LIGHTS_AT: leds, GAUGE_AT: gauge}, world.clock)
    cameras, line, firmware = CameraWire(world, CAMERA_ID), ButtonLine(world), Firmware()
    machine = Machine(
        load_cameras=lambda: cameras,
        open_bus=wire.open,
        open_input=lambda *_place: lambda: line,
        throttled_file=firmware.read,
    )
    hardware = board_hardware(world.profile, world.clock, machine, TwinOperator(world))
    return Wired(world, hardware, leds, gauge, wire, cameras, line, firmware)


def led_model(chip: Chip) -> LedDriverModel:
    """The register model of that chip, as after power-on."""
    return Pca9955bModel() if chip == "PCA9955B" else Tlc59116Model()


def lighting(world: Bench, leds: LedDriverModel) -> Callable[[], None]:
    """What follows from the chip's registers: each light shines with the mean current of its LEDs."""

    def follow() -> None:
        currents_ma = leds.currents_ma()
        shining = {
            light.name: sum(currents_ma[channel] for channel in light.channels) / len(light.channels)
            for light in world.profile.lights
        }
        world.drive({name: current for name, current in shining.items() if current > 0.0})

    return follow
