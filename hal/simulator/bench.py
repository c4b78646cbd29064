"""The simulated world: specimen, lights and time. Camera, lights and button are views of it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Final, Generic, TypeVar

import numpy as np

from hal.board_profile import BoardProfile, TwinConfig
from hal.errors import BoardProfileError
from hal.frame import CameraSettings, RawFrame
from hal.interfaces import ButtonPress, Clock, Cue
from hal.simulator.scene import Press, Scene, expose, native_order, render
from hal.simulator.surfaces import Float32Array, MaskArray


@dataclass(slots=True)
class Faults:
    """Fault switches of the simulated world; each may be set at any time.

    camera_missing : the camera does not answer when opened or read
    camera_stalled : the camera delivers no more frames
    controls_ignored : requested exposure and gain never take effect
    lights_silent : the light driver does not acknowledge
    lights_broken : the driver answers, but no light comes on
    open_lights : lights whose LED is not connected: the driver reports "open", and the light stays off
    dimmed : remaining fraction of the light of an ageing LED, by name
    button_unreadable : the button's line cannot be read
    under_voltage : the supply voltage is too low
    battery_share : charge of the battery, 0 to 1; None: no battery gauge
    wobble_mm : the hand moves what it presses to and fro by so much, every `WOBBLE_NS`
    dirty : dust lies on the skin
    ambient : daylight that reaches the skin, fraction of full scale in an exposure
    leaning, too_deep : the operator's next presses lean, or go as deep as the gel allows
    """

    camera_missing: bool = False
    camera_stalled: bool = False
    controls_ignored: bool = False
    lights_silent: bool = False
    lights_broken: bool = False
    open_lights: set[str] = field(default_factory=set)
    dimmed: dict[str, float] = field(default_factory=dict)
    button_unreadable: bool = False
    under_voltage: bool = False
    battery_share: float | None = None
    wobble_mm: float = 0.0
    dirty: bool = False
    ambient: float = 0.0
    leaning: bool = False
    too_deep: bool = False


WOBBLE_NS: Final = 40_000_000
SPECKS: Final = 5
SPECK_MM: Final = 0.5
SPECK_LIGHT: Final = 0.4
"""Dust: so many round specks of that radius, which leave that fraction of the light."""

Value = TypeVar("Value")


MAX_AGE_NS: Final = 60_000_000_000
"""Values that ended longer ago than this are dropped; longer than any exposure."""


class Timeline(Generic[Value]):
    """A value and its recent past.

    Parameters
    ----------
    start_ns : begin of the first value, which also applies before it
    value : the first value
    """

    def __init__(self, start_ns: int, value: Value) -> None:
        self._changes: list[tuple[int, Value]] = [(start_ns, value)]

    def change(self, at_ns: int, value: Value) -> None:
        """Set `value` from `at_ns` on; changes come in order of their times."""
        self._changes.append((at_ns, value))
        while len(self._changes) > 1 and self._changes[1][0] < at_ns - MAX_AGE_NS:
            del self._changes[0]

    @property
    def latest(self) -> Value:
        """The current value."""
        return self._changes[-1][1]

    def value_at(self, at_ns: int) -> Value:
        """Return the value at that time."""
        held = self._changes[0][1]
        for start_ns, value in self._changes:
            if start_ns > at_ns:
                break
            held = value
        return held

    def spans(self, began_ns: int, ended_ns: int) -> Iterator[tuple[int, Value]]:
        """Yield every value within the interval, with its duration (ns) in it."""
        ends = [start for start, _ in self._changes[1:]] + [ended_ns]
        starts = [began_ns] + [start for start, _ in self._changes[1:]]
        for (_, value), start, end in zip(self._changes, starts, ends, strict=True):
            overlap_ns = min(end, ended_ns) - max(start, began_ns)
            if overlap_ns > 0:
                yield overlap_ns, value


@dataclass(frozen=True, slots=True, eq=False)
class TwinTruth:
    """The true skin on the camera's own pixel grid.

    z_um : float32 array of shape (H, W), µm above the untouched skin, of the point that each pixel sees
    p, q : float32 arrays of shape (H, W), µm/µm; central differences of `z_um` along columns and rows
    contact : bool array of shape (H, W), True where the skin touches the object
    pitch_um : nominal distance of neighbouring pixels on the untouched skin, µm
    """

    z_um: Float32Array
    p: Float32Array
    q: Float32Array
    contact: MaskArray
    pitch_um: float


class SimulatedScene:
    """The world shared by the twin's devices.

    Parameters
    ----------
    profile : a board whose driver is the twin
    clock : the time of this world
    seed : of noise and placement

    `faults` may be set at any time; `cues` lists what the indicator has shown, with times (ns).
    """

    def __init__(self, profile: BoardProfile, clock: Clock, seed: int) -> None:
        if profile.twin is None:
            raise BoardProfileError(f"board {profile.name!r} has no [twin] table: name a board of the twin")
        self.profile = profile
        self.clock = clock
        self.seed = seed
        self.faults = Faults()
        self.twin: TwinConfig = profile.twin
        self._pressed: Timeline[Press | None] = Timeline(clock.monotonic_ns(), None)
        self._driven: Timeline[dict[str, float]] = Timeline(clock.monotonic_ns(), {})
        self._button: list[ButtonPress] = []
        self.cues: list[tuple[int, Cue]] = []

    @property
    def pressed(self) -> Press | None:
        """The current press on the gel, if any."""
        return self._pressed.latest

    def place(self, press: Press | None) -> None:
        """Press something on the gel from now on, or nothing."""
        self._pressed.change(self.clock.monotonic_ns(), press)

    def place_at(self, at_ns: int, press: Press | None) -> None:
        """Place the press from a later time on: presses that deepen are placed one after the other."""
        self._pressed.change(at_ns, press)

    def drive(self, currents_ma: Mapping[str, float]) -> None:
        """Drive the lights with these currents (mA) from now on; lights not named are off."""
        self._driven.change(self.clock.monotonic_ns(), dict(currents_ma))

    @property
    def currents_ma(self) -> dict[str, float]:
        """Present currents (mA) by light; empty when off."""
        return dict(self._driven.latest)

    def schedule_button(self, press: ButtonPress) -> None:
        """Schedule a push of the button."""
        self._button.append(press)
        self._button.sort(key=lambda p: p.began_ns)

    def withdraw_button(self, press: ButtonPress) -> None:
        """Take a scheduled push back; no effect once it was taken."""
        if press in self._button:
            self._button.remove(press)

    def next_button_press(self) -> ButtonPress | None:
        """Return the next scheduled push, if any."""
        return self._button[0] if self._button else None

    def take_button_press(self) -> ButtonPress:
        """Remove the next scheduled push and return it."""
        return self._button.pop(0)

    def truth(self) -> TwinTruth:
        """Return the true skin now."""
        skin = self._scene(self.clock.monotonic_ns()).skin
        z_um = skin.height_mm * np.float32(1e3)
        pitch_um = self.profile.sensor.pixel_pitch_um
        q, p = np.gradient(z_um / np.float32(pitch_um))
        return TwinTruth(z_um, np.asarray(p, np.float32), np.asarray(q, np.float32), skin.contact, pitch_um)

    def expose(self, index: int, began_ns: int, settings: CameraSettings) -> RawFrame:
        """Return the frame with that index whose exposure began then; its noise depends on seed and index only."""
        exposure_ns = round(settings.exposure_us * 1e3)
        scene = self._scene(began_ns + exposure_ns // 2)
        sensor = self.profile.sensor
        charge_e = np.zeros((sensor.rows, sensor.columns), np.float32)
        for light, per_ma_ms in zip(self.profile.lights, scene.charge_e, strict=True):
            dose = self._dose_ma_ms(light.name, began_ns, began_ns + exposure_ns)
            if dose > 0.0 and not (self.faults.lights_broken or light.name in self.faults.open_lights):
                charge_e += per_ma_ms * np.float32(dose * self.faults.dimmed.get(light.name, 1.0))
        charge_e += np.float32(self.faults.ambient * sensor.full_well_e)
        if self.faults.dirty:
            charge_e *= dust((sensor.rows, sensor.columns), sensor.pixel_pitch_um, self.seed)
        random = np.random.Generator(np.random.SFC64([self.seed, index]))
        mosaic = expose(charge_e, sensor, settings.analogue_gain, random)
        return RawFrame(mosaic, native_order(sensor), sensor.black_level_dn, sensor.white_level_dn, settings, began_ns)

    def _scene(self, at_ns: int) -> Scene:
        press, wobble_mm = self._pressed.value_at(at_ns), self.faults.wobble_mm
        if press and wobble_mm and at_ns // WOBBLE_NS % 2:
            press = replace(press, centre_mm=(press.centre_mm[0] + wobble_mm, press.centre_mm[1]))
        return rendered(self.profile, press)

    def _dose_ma_ms(self, light: str, began_ns: int, ended_ns: int) -> float:
        """Return the current times duration (mA ms) of one light within an exposure, including changes during it."""
        spans = self._driven.spans(began_ns, ended_ns)
        return sum(currents.get(light, 0.0) * overlap_ns * 1e-6 for overlap_ns, currents in spans)


@lru_cache(maxsize=8)
def rendered(profile: BoardProfile, press: Press | None) -> Scene:
    """Return the scene of a press, which all worlds of that profile share: its arrays cannot be written to."""
    scene = render(profile, press)
    for array in (scene.skin.height_mm, scene.skin.contact, *scene.charge_e):
        array.setflags(write=False)
    return scene


@lru_cache(maxsize=1)
def dust(shape: tuple[int, int], pitch_um: float, seed: int) -> Float32Array:
    """Return the fraction of the light that dust leaves in every pixel: float32 array of `shape` (H, W)."""
    random = np.random.default_rng([seed, 0xD0])
    row, column = np.mgrid[: shape[0], : shape[1]].astype(np.float32)
    left = np.ones(shape, np.float32)
    for at_row, at_column in random.uniform((0.0, 0.0), shape, (SPECKS, 2)):
        inside = np.hypot(row - np.float32(at_row), column - np.float32(at_column)) < 1e3 * SPECK_MM / pitch_um
        left[inside] = SPECK_LIGHT
    return left


def build(profile: BoardProfile, clock: Clock, seed: int | None = None) -> SimulatedScene:
    """Return a world with an untouched gel and lights off; uses the profile's seed by default.

    Raises
    ------
    BoardProfileError
        The profile has no [twin] table.
    """
    if profile.twin is None:
        raise BoardProfileError(f"board {profile.name!r} has no [twin] table: name a board of the twin")
    return SimulatedScene(profile, clock, profile.twin.seed if seed is None else seed)
