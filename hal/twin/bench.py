"""The one simulated world: what is pressed, which lights shine, when. Camera, lights and button are views of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from hal.board_profile import BoardProfile, TwinFacts
from hal.errors import BoardProfileError
from hal.frame import CameraSettings, RawFrame
from hal.interfaces import ButtonPress, Clock, Cue
from hal.twin.arrays import Float32Array, MaskArray
from hal.twin.faults import Faults
from hal.twin.scene import Press, Scene, render
from hal.twin.sensor import expose
from hal.twin.timeline import Timeline


@dataclass(frozen=True, slots=True, eq=False)
class TwinTruth:
    """The skin as it really lies, on the camera's own pixel grid.

    z_um : float32 array of shape (H, W), µm above the resting skin, of the point that each pixel sees
    p, q : float32 arrays of shape (H, W), µm/µm; central differences of `z_um` along columns and rows
    contact : bool array of shape (H, W), True where the skin touches the object
    pitch_um : nominal distance of neighbouring pixels on the resting skin, µm
    """

    z_um: Float32Array
    p: Float32Array
    q: Float32Array
    contact: MaskArray
    pitch_um: float


class Bench:
    """The world that the twin's devices share.

    Parameters
    ----------
    profile : a board whose driver is the twin
    clock : the time of this world
    seed : of noise and placement

    Its `faults` may be switched at any time; `cues` are what its indicator has shown, with the times (ns).
    """

    def __init__(self, profile: BoardProfile, clock: Clock, seed: int) -> None:
        if profile.twin is None:
            raise BoardProfileError(f"board {profile.name!r} has no [twin] table: name a board of the twin")
        self.profile = profile
        self.clock = clock
        self.seed = seed
        self.faults = Faults()
        self.twin: TwinFacts = profile.twin
        self._render = lru_cache(maxsize=2)(lambda press: render(profile, press))
        self._pressed: Timeline[Press | None] = Timeline(clock.monotonic_ns(), None)
        self._driven: Timeline[dict[str, float]] = Timeline(clock.monotonic_ns(), {})
        self._button: list[ButtonPress] = []
        self.cues: list[tuple[int, Cue]] = []

    @property
    def pressed(self) -> Press | None:
        """What is pressed on the gel now, if anything."""
        return self._pressed.latest

    def place(self, press: Press | None) -> None:
        """Press something on the gel from now on, or nothing."""
        self._pressed.change(self.clock.monotonic_ns(), press)

    def drive(self, currents_ma: Mapping[str, float]) -> None:
        """Drive the lights with these currents (mA) from now on; lights that are not named are dark."""
        self._driven.change(self.clock.monotonic_ns(), dict(currents_ma))

    @property
    def currents_ma(self) -> dict[str, float]:
        """Currents (mA) that flow now, by light; empty when dark."""
        return dict(self._driven.latest)

    def schedule_button(self, press: ButtonPress) -> None:
        """Somebody will push the button then."""
        self._button.append(press)
        self._button.sort(key=lambda p: p.began_ns)

    def next_button_press(self) -> ButtonPress | None:
        """The push that comes next, if any is to come."""
        return self._button[0] if self._button else None

    def take_button_press(self) -> ButtonPress:
        """The same, and it is over."""
        return self._button.pop(0)

    def truth(self) -> TwinTruth:
        """Where the skin lies now."""
        skin = self._scene(self.clock.monotonic_ns()).skin
        z_um = skin.height_mm * np.float32(1e3)
        pitch_um = self.profile.sensor.pixel_pitch_um
        q, p = np.gradient(z_um / np.float32(pitch_um))
        return TwinTruth(z_um, np.asarray(p, np.float32), np.asarray(q, np.float32), skin.contact, pitch_um)

    def expose(self, index: int, began_ns: int, settings: CameraSettings) -> RawFrame:
        """The frame with that index whose exposure began then; its noise depends on seed and index alone."""
        exposure_ns = round(settings.exposure_us * 1e3)
        scene = self._scene(began_ns + exposure_ns // 2)
        sensor = self.profile.sensor
        charge_e = np.zeros((sensor.rows, sensor.columns), np.float32)
        for light, per_ma_ms in zip(self.profile.lights, scene.charge_e, strict=True):
            dose = self._dose_ma_ms(light.name, began_ns, began_ns + exposure_ns)
            if dose > 0.0 and not (self.faults.lights_broken or light.name in self.faults.open_lights):
                charge_e += per_ma_ms * np.float32(dose * self.faults.dimmed.get(light.name, 1.0))
        random = np.random.Generator(np.random.SFC64([self.seed, index]))
        mosaic = expose(charge_e, sensor, settings.analogue_gain, random)
        return RawFrame(mosaic, sensor.bayer_order, sensor.black_level_dn, sensor.white_level_dn, settings, began_ns)

    def _scene(self, at_ns: int) -> Scene:
        return self._render(self._pressed.value_at(at_ns))

    def _dose_ma_ms(self, light: str, began_ns: int, ended_ns: int) -> float:
        """Current times duration (mA ms) of one light within an exposure: a change half-way counts for its part."""
        spans = self._driven.spans(began_ns, ended_ns)
        return sum(currents.get(light, 0.0) * overlap_ns * 1e-6 for overlap_ns, currents in spans)


def build(profile: BoardProfile, clock: Clock, seed: int | None = None) -> Bench:
    """A world with nothing on the gel and every light dark; the profile's seed unless another is given.

    Raises
    ------
    BoardProfileError
        The profile has no [twin] table.
    """
    if profile.twin is None:
        raise BoardProfileError(f"board {profile.name!r} has no [twin] table: name a board of the twin")
    return Bench(profile, clock, profile.twin.seed if seed is None else seed)
