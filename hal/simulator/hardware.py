"""The twin's hardware: devices that are views of one simulated world."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Final, Self

from hal.board_profile import BoardProfile, LightDriverConfig
from hal.drivers.board_hardware import Machine, board_hardware
from hal.drivers.i2c_bus import OpenBus, SmBus
from hal.errors import BoardProfileError, ButtonError, LightError
from hal.hardware import Hardware
from hal.interfaces import ButtonPress, Clock, Cue, LightFault, PowerReading, PressObject
from hal.simulator.bench import SimulatedScene, build
from hal.simulator.camera import TwinCamera
from hal.simulator.led_chips import LedDriverModel, Pca9955bModel, Tlc59116Model
from hal.simulator.operator import TwinOperator


def twin_hardware(bench: SimulatedScene) -> Hardware:
    """Return camera, lights, button and operator of one simulated world."""
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


class TwinIndicator:
    """See `hal.interfaces.Indicator`; showing takes no time."""

    def __init__(self, bench: SimulatedScene) -> None:
        self._bench = bench

    def show(self, cue: Cue) -> None:
        """Record the cue and its time."""
        self._bench.cues.append((self._bench.clock.monotonic_ns(), cue))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        return None


class TwinPower:
    """See `hal.interfaces.Power`; the battery is one of the world's faults."""

    def __init__(self, bench: SimulatedScene) -> None:
        self._bench = bench

    def read(self) -> PowerReading:
        """Return the supply according to the world's faults."""
        low = self._bench.faults.under_voltage
        charge = self._bench.faults.battery_share
        return PowerReading(under_voltage=low, was_under_voltage=low, throttled=low, battery_share=charge)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        return None


class TwinButton:
    """A debounced push button; see `hal.interfaces.Button`."""

    def __init__(self, bench: SimulatedScene) -> None:
        self._bench = bench
        self._reported_ns: int | None = None

    def wait_for_push(self, timeout_s: float | None) -> int | None:
        """Begin of the next press (ns), at that moment, or None after `timeout_s`.

        Raises
        ------
        ButtonError
            The line cannot be read; or the wait would never end, because no push is scheduled.
        """
        while (press := self._bench.next_button_press()) and not self._is_new(press):
            self._bench.take_button_press()
        if not self._slept_until(None if press is None else press.began_ns, timeout_s):
            return None
        self._reported_ns = press.began_ns if press else None
        return self._reported_ns

    def wait_for_press(self, timeout_s: float | None) -> ButtonPress | None:
        """Return the next press after its release, or None after `timeout_s`.

        Raises
        ------
        ButtonError
            As for `wait_for_push`.
        """
        press = self._bench.next_button_press()
        released_ns = None if press is None else press.began_ns + round(press.held_s * 1e9)
        return self._bench.take_button_press() if self._slept_until(released_ns, timeout_s) else None

    def is_down(self) -> bool:
        """Return whether the button is down now."""
        now_ns = self._bench.clock.monotonic_ns()
        press = self._bench.next_button_press()
        return press is not None and press.began_ns <= now_ns <= press.began_ns + round(press.held_s * 1e9)

    def clear_presses(self) -> int:
        """Drop all pushes that have begun; returns how many `wait_for_push` had not reported."""
        dropped = 0
        while (press := self._bench.next_button_press()) and press.began_ns <= self._bench.clock.monotonic_ns():
            dropped += self._is_new(self._bench.take_button_press())
        return dropped

    def _is_new(self, press: ButtonPress) -> bool:
        return self._reported_ns is None or press.began_ns > self._reported_ns

    def _slept_until(self, at_ns: int | None, timeout_s: float | None) -> bool:
        """Sleep until then, or for `timeout_s` if that is sooner; returns whether that time was reached."""
        if self._bench.faults.button_unreadable:
            raise ButtonError("the twin's button cannot be read: check the line name in the board profile")
        if at_ns is None and timeout_s is None:
            raise ButtonError("no push of the twin's button is scheduled: send its operator a request first")
        clock = self._bench.clock
        wait_s = None if at_ns is None else (at_ns - clock.monotonic_ns()) * 1e-9
        comes = wait_s is not None and (timeout_s is None or wait_s <= timeout_s)
        clock.sleep(wait_s if comes and wait_s is not None else timeout_s or 0.0)
        return comes

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        return None


MAX_CURRENT_MA: Final = 57.0


class TwinLights:
    """Three lights set by current; see `hal.interfaces.Lights`."""

    def __init__(self, bench: SimulatedScene) -> None:
        self._bench = bench

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the lights in R, G, B order."""
        return tuple(light.name for light in self._bench.profile.lights)

    @property
    def max_ma(self) -> float:
        """Maximum current of a light, mA."""
        return MAX_CURRENT_MA

    def granted_ma(self, currents_ma: Mapping[str, float]) -> dict[str, float]:
        """Return the same currents (mA): the twin has no steps.

        Raises
        ------
        LightError
            An unknown name, or a current out of range.
        """
        for name, current in currents_ma.items():
            if name not in self.names:
                raise LightError(f"unknown light {name!r}: name one of {', '.join(self.names)}")
            if not 0.0 <= current <= MAX_CURRENT_MA:
                raise LightError(
                    f"light {name!r} cannot be driven with {current:g} mA: choose 0 to {MAX_CURRENT_MA:g} mA"
                )
        return dict(currents_ma)

    def switch_on(self, currents_ma: Mapping[str, float]) -> None:
        """Drive each named light with its current (mA); all others are off.

        Raises
        ------
        LightError
            An unknown name, a current out of range, or a driver that does not answer.
        """
        self.granted_ma(currents_ma)
        self._check_answering()
        self._bench.drive(currents_ma)

    def off(self) -> None:
        """Switch every light off."""
        self._check_answering()
        self._bench.drive({})

    def faults(self) -> tuple[LightFault, ...]:
        """ "open" for every broken light."""
        self._check_answering()
        faults = self._bench.faults
        open_lights = self.names if faults.lights_broken else [n for n in self.names if n in faults.open_lights]
        return tuple(LightFault(name, "open") for name in open_lights)

    def __enter__(self) -> Self:
        self.off()
        return self

    def __exit__(self, *exc: object) -> None:
        self.off()

    def _check_answering(self) -> None:
        if self._bench.faults.lights_silent:
            raise LightError("the twin's light driver does not acknowledge: check its address, wiring and supply")


# This machine's bus and lines with the twin's camera: the simulated world mirrors what is written to the real bus.
#
# For boards without a camera, such as a virtual one: button and lights go through the kernel, and the model of the
# driver chip receives every transfer on the bus, so a frame shows the lights that the driver really switched. An object
# lies on the gel from the start, because a person who pushes the button sends no request to the operator.

ON_THE_GEL: Final = PressObject("coin")


class MirroredBus:
    """A bus that forwards every successful write at one address to a chip model; see `SmBus`."""

    def __init__(self, bus: SmBus, address: int, model: LedDriverModel) -> None:
        self._bus = bus
        self._address = address
        self._model = model

    def read_i2c_block_data(self, i2c_addr: int, register: int, length: int) -> list[int]:
        """Read registers from `register` on, from the real bus."""
        return self._bus.read_i2c_block_data(i2c_addr, register, length)

    def write_i2c_block_data(self, i2c_addr: int, register: int, data: Sequence[int]) -> None:
        """Write registers from `register` on; failed writes are not mirrored."""
        self._bus.write_i2c_block_data(i2c_addr, register, data)
        if i2c_addr == self._address:
            self._model.write(register, data)

    def close(self) -> None:
        """Release the bus."""
        self._bus.close()


def mirrored_board_hardware(
    profile: BoardProfile, clock: Clock, seed: int | None = None, machine: Machine | None = None
) -> Hardware:
    """Return the hardware of a profile whose driver is "twin-camera"; nothing is accessed before it is entered.

    Raises
    ------
    BoardProfileError
        The profile lacks a required table.
    """
    config = profile.light_driver
    if config is None:
        raise BoardProfileError(f"board {profile.name!r} has no [light_driver] table: add it")
    world = build(profile, clock, seed)
    operator = TwinOperator(world)
    operator.ask(ON_THE_GEL)
    model = led_model(config.chip, config.reference_ohm)
    model.changed = lighting(world, model)
    machine = machine or Machine()
    mirrored = replace(machine, open_bus=_mirroring(machine.open_bus, config, model))
    return board_hardware(profile, clock, mirrored, operator, TwinCamera(world))


def _mirroring(open_bus: OpenBus, config: LightDriverConfig, model: LedDriverModel) -> Callable[[int], SmBus]:
    """Return a function that opens buses and mirrors that of the light driver."""

    def opened(number: int) -> SmBus:
        bus = open_bus(number)
        return MirroredBus(bus, config.address, model) if number == config.bus else bus

    return opened


def led_model(chip: str, reference_ohm: float) -> LedDriverModel:
    """Register model of that chip with that resistor at REXT, in its power-on state."""
    return {"PCA9955B": Pca9955bModel, "TLC59116": Tlc59116Model}[chip](reference_ohm)


def lighting(world: SimulatedScene, leds: LedDriverModel) -> Callable[[], None]:
    """Return a callback that drives the world's lights as the chip's registers state.

    The current of a light is the mean over its LEDs.
    """

    def follow() -> None:
        currents_ma = leds.currents_ma()
        shining = {
            light.name: sum(currents_ma[channel] for channel in light.channels) / len(light.channels)
            for light in world.profile.lights
        }
        world.drive({name: current for name, current in shining.items() if current > 0.0})

    return follow
