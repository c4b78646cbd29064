"""A real board as hardware: the drivers that its profile names, on the libraries of the machine or on emulated ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from hal.board_profile import BoardProfile, LightDriverConfig
from hal.drivers.button_debounced import DebouncedButton
from hal.drivers.camera_picamera2 import PicameraCamera
from hal.drivers.chip_lights import ChipLights, LedChip, LightGate, SwitchedLine
from hal.drivers.gpio_lines import (
    ENABLE_HIGH,
    ENABLE_LOW,
    BlinkIndicator,
    GpiodInput,
    GpiodOutput,
    NoIndicator,
    OpenInput,
    OutputRole,
)
from hal.drivers.i2c_bus import I2cChip, OpenBus, open_smbus
from hal.drivers.lights_pca9955b import Pca9955b
from hal.drivers.lights_tlc59116 import Tlc59116
from hal.drivers.picamera_stack import CameraStack, load_picamera2
from hal.drivers.power_board import BoardPower, Max17048, read_throttled_file, run_vcgencmd
from hal.errors import BoardProfileError, LightError, PowerError
from hal.hardware import Hardware, ManualOperator
from hal.interfaces import Camera, Clock, Indicator, Operator


@dataclass(frozen=True, slots=True)
class Machine:
    """Ground that drivers run on: the libraries of a real machine, or emulated ones.

    open_input : from label, offset and active_low
    """

    load_cameras: Callable[[], CameraStack] = load_picamera2
    open_bus: OpenBus = open_smbus
    open_input: Callable[[str, int, bool], OpenInput] = lambda *place: partial(GpiodInput.open, *place)
    output: Callable[[str, int], GpiodOutput] = GpiodOutput
    gate: Callable[[str, int, OutputRole], SwitchedLine] = lambda label, line, role: GpiodOutput(label, line, role=role)
    throttled_file: Callable[[], str] = read_throttled_file
    vcgencmd: Callable[[], str] = run_vcgencmd


def board_hardware(
    profile: BoardProfile,
    clock: Clock,
    machine: Machine | None = None,
    operator: Operator | None = None,
    camera: Camera | None = None,
) -> Hardware:
    """Return the hardware of a real board; nothing is accessed before it is entered.

    camera : used where the profile has no [libcamera] table

    Raises
    ------
    BoardProfileError
        The profile lacks a table that a real board needs.
    """
    machine = machine or Machine()
    light_driver, button = profile.light_driver, profile.button
    if profile.libcamera is not None:
        camera = PicameraCamera(profile.sensor, profile.libcamera, profile.camera.settings, machine.load_cameras, clock)
    if camera is None or light_driver is None or button is None:
        raise BoardProfileError(
            f"board {profile.name!r} lacks one of the tables [libcamera], [light_driver], [button]: add it"
        )
    gate = _gate(light_driver, button.chip_label, machine)
    lights = ChipLights(profile.lights, _led_chip(light_driver, machine, clock), gate)
    open_line = machine.open_input(button.chip_label, button.line, button.active_low)
    return Hardware(
        profile=profile,
        camera=camera,
        lights=lights,
        button=DebouncedButton(open_line, clock),
        indicator=_indicator(profile, button.chip_label, lights, machine, clock),
        power=_power(profile, machine, clock),
        operator=operator or ManualOperator(),
        clock=clock,
    )


def _led_chip(config: LightDriverConfig, machine: Machine, clock: Clock) -> LedChip:
    what = f"light driver {config.chip}"
    chip = I2cChip(machine.open_bus, config.bus, config.address, what, LightError, clock)
    drivers: dict[str, Callable[[I2cChip, float], LedChip]] = {"PCA9955B": Pca9955b, "TLC59116": Tlc59116}
    return drivers[config.chip](chip, config.reference_ohm)


def _gate(config: LightDriverConfig, chip_label: str, machine: Machine) -> LightGate:
    """OE of a PCA9955B shines at low, RESET of a TLC59116 lets it work at high."""
    if config.enable_line is None:
        return LightGate()
    resets = config.chip == "TLC59116"
    line = machine.gate(chip_label, config.enable_line, ENABLE_HIGH if resets else ENABLE_LOW)
    return LightGate(line, holds_reset=resets)


def _indicator(profile: BoardProfile, chip_label: str, lights: ChipLights, machine: Machine, clock: Clock) -> Indicator:
    config = profile.indicator
    if config is None:
        return NoIndicator()
    if config.line is not None:
        output = machine.output(chip_label, config.line)
        return BlinkIndicator(output.switch, output.release, clock)
    channel, current_ma = config.channel or 0, config.current_ma
    return BlinkIndicator(lambda on: lights.hold_spare(channel, current_ma if on else 0.0), lambda: None, clock)


def _power(profile: BoardProfile, machine: Machine, clock: Clock) -> BoardPower:
    config = profile.power
    if config is None:
        return BoardPower(None, None)
    gauge = None
    if config.fuel_gauge is not None:
        place = config.fuel_gauge
        what = f"fuel gauge {place.chip}"
        gauge = Max17048(I2cChip(machine.open_bus, place.bus, place.address, what, PowerError, clock))
    return BoardPower(machine.throttled_file if config.throttled == "sysfs" else machine.vcgencmd, gauge)
