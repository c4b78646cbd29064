"""A real board as hardware: every driver that its profile names, over the libraries of the machine or their likes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from hal.board_parts import LightDriverFacts
from hal.board_profile import BoardProfile
from hal.button_debounced import DebouncedButton
from hal.camera_picamera2 import PicameraCamera
from hal.chip_lights import ChipLights, LedChip
from hal.errors import BoardProfileError, LightError, PowerError
from hal.gpio_lines import GpiodInput, GpiodOutput, OpenInput
from hal.hardware import Hardware
from hal.i2c_bus import I2cChip, OpenBus, open_smbus
from hal.interfaces import Camera, Clock, Indicator, Operator
from hal.lights_pca9955b import Pca9955b
from hal.lights_tlc59116 import Tlc59116
from hal.person import Person
from hal.picamera_stack import CameraStack, load_picamera2
from hal.power_board import BoardPower, Max17048, read_throttled_file, run_vcgencmd
from hal.rhythm_indicator import NoIndicator, RhythmIndicator


@dataclass(frozen=True, slots=True)
class Machine:
    """What a board's drivers stand on: the libraries of a real machine, or likenesses of them.

    open_input : from label, offset and active_low
    """

    load_cameras: Callable[[], CameraStack] = load_picamera2
    open_bus: OpenBus = open_smbus
    open_input: Callable[[str, int, bool], OpenInput] = lambda *place: partial(GpiodInput.open, *place)
    output: Callable[[str, int], GpiodOutput] = GpiodOutput
    throttled_file: Callable[[], str] = read_throttled_file
    vcgencmd: Callable[[], str] = run_vcgencmd


def board_hardware(
    profile: BoardProfile,
    clock: Clock,
    machine: Machine | None = None,
    operator: Operator | None = None,
    camera: Camera | None = None,
) -> Hardware:
    """The hardware of a real board; nothing is touched before it is entered.

    camera : the one to use where the profile has no [libcamera] table

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
            f"board {profile.name!r} lacks one of the tables [libcamera], [light_driver], [button]: complete it"
        )
    lights = ChipLights(profile.lights, _led_chip(light_driver, machine, clock))
    open_line = machine.open_input(button.chip_label, button.line, button.active_low)
    return Hardware(
        profile=profile,
        camera=camera,
        lights=lights,
        button=DebouncedButton(open_line, clock),
        indicator=_indicator(profile, button.chip_label, lights, machine, clock),
        power=_power(profile, machine, clock),
        operator=operator or Person(),
        clock=clock,
    )


def _led_chip(facts: LightDriverFacts, machine: Machine, clock: Clock) -> LedChip:
    what = f"light driver {facts.chip}"
    chip = I2cChip(machine.open_bus, facts.bus, facts.address, what, LightError, clock)
    kind = Pca9955b if facts.chip == "PCA9955B" else Tlc59116
    return kind(chip, facts.reference_ohm)


def _indicator(profile: BoardProfile, chip_label: str, lights: ChipLights, machine: Machine, clock: Clock) -> Indicator:
    facts = profile.indicator
    if facts is None:
        return NoIndicator()
    if facts.line is not None:
        output = machine.output(chip_label, facts.line)
        return RhythmIndicator(output.switch, output.release, clock)
    channel, current_ma = facts.channel or 0, facts.current_ma
    return RhythmIndicator(lambda on: lights.hold_spare(channel, current_ma if on else 0.0), lambda: None, clock)


def _power(profile: BoardProfile, machine: Machine, clock: Clock) -> BoardPower:
    facts = profile.power
    if facts is None:
        return BoardPower(None, None)
    gauge = None
    if facts.fuel_gauge is not None:
        place = facts.fuel_gauge
        what = f"fuel gauge {place.chip}"
        gauge = Max17048(I2cChip(machine.open_bus, place.bus, place.address, what, PowerError, clock))
    return BoardPower(machine.throttled_file if facts.throttled == "sysfs" else machine.vcgencmd, gauge)
