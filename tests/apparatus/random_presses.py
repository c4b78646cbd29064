"""Random presses of the whole instrument on the twin, with lights as calibrated or not, and the verdicts on them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Final, Literal

import numpy as np

from device.bundles.scan import VerdictRecord
from device.instrument.events import ScanFinished
from device.instrument.instrument import Instrument
from hal.interfaces import ButtonPress
from hal.simulator.bench import SimulatedScene
from hal.simulator.operator import gallery_names, specimen
from hal.simulator.scene import Press
from hal.simulator.surfaces import Block, Plane, Surface, Texture

WHOLE_FIELD: Final = Block(20.0, 20.0)
WHOLE_FIELD_OBJECTS: Final[Mapping[str, tuple[Surface, float]]] = {
    "whole-plane": (Plane(WHOLE_FIELD, 0.012, 0.005), 0.9),
    "whole-weave": (Texture(WHOLE_FIELD, 0.012, 0.5, 0.15), 0.4),
    "whole-coarse-weave": (Texture(WHOLE_FIELD, 0.02, 1.1, 0.3), 0.6),
}
"""Objects that leave no untouched skin in view, with their depth in mm."""

NOTHING: Final = "nothing"
TOLERATED: Final = 0.02
PLACES_MM: Final = (2.0, 1.5)
TURN_RAD: Final = 0.5

When = Literal["in air", "in contact", "slowly"]


@dataclass(frozen=True, slots=True)
class RandomPress:
    """One press: what, where, and the levels of the lights from a moment on.

    name : of the gallery, of `WHOLE_FIELD_OBJECTS`, or `NOTHING`
    levels : fraction of each light's own light
    when : the levels change at once with nothing on the gel, at once under the object, or in steps from press to press
    """

    name: str
    centre_mm: tuple[float, float]
    turn_rad: float
    levels: Mapping[str, float]
    when: When

    @property
    def is_off(self) -> bool:
        """Whether a light is off by more than tolerated."""
        return any(abs(level - 1.0) > TOLERATED for level in self.levels.values())

    def press(self) -> Press | None:
        """The press for the twin."""
        if self.name == NOTHING:
            return None
        if self.name in WHOLE_FIELD_OBJECTS:
            surface, depth_mm = WHOLE_FIELD_OBJECTS[self.name]
        else:
            surface, depth_mm = specimen(self.name).surface, specimen(self.name).indentation_mm
        return Press(surface, self.centre_mm, self.turn_rad, depth_mm)


def random_presses(count: int, seed: int, lights: tuple[str, ...], *, healthy: bool) -> Iterator[RandomPress]:
    """Presses of every object in turn at random places; unless `healthy` with at least one light off."""
    random = np.random.default_rng(seed)
    names = gallery_names() if healthy else (*gallery_names(), *WHOLE_FIELD_OBJECTS, NOTHING)
    whens: tuple[When, ...] = ("in air", "in contact", "slowly")
    for number in range(count):
        levels = np.ones(3)
        while not healthy and np.abs(levels - 1.0).max() <= TOLERATED:
            levels = _random_levels(random)
        x, y = (float(reach * random.uniform(-1.0, 1.0)) for reach in PLACES_MM)
        turn = float(random.uniform(-TURN_RAD, TURN_RAD))
        named = {light: float(level) for light, level in zip(lights, levels, strict=True)}
        yield RandomPress(names[number % len(names)], (x, y), turn, named, whens[int(random.integers(len(whens)))])


def _random_levels(random: np.random.Generator) -> np.ndarray:
    """Levels of three lights: all far off, one off, or all off by little."""
    kind = int(random.integers(4))
    if kind == 0:
        return random.uniform(0.5, 1.3, 3)
    if kind == 1:
        return random.uniform(0.95, 1.05, 3)
    levels = np.ones(3)
    far = (0.5, 1.3) if kind == 2 else (0.96, 1.04)
    levels[random.integers(3)] = random.uniform(*far)
    return levels


@dataclass(slots=True)
class Tally:
    """Presses and good verdicts by object, and every verdict that is wrong."""

    presses: Counter[str] = field(default_factory=Counter)
    good: Counter[str] = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)

    def add(self, press: RandomPress, verdict: VerdictRecord) -> None:
        """Count one verdict."""
        self.presses[press.name] += 1
        self.good[press.name] += verdict.level == "good"
        if (verdict.level == "good") == press.is_off:
            levels = ", ".join(f"{name} {level:.3f}" for name, level in press.levels.items())
            self.wrong.append(
                f"{press.name} at {press.centre_mm}, {levels} ({press.when}): {verdict.level}: {verdict.reason}"
            )

    def __str__(self) -> str:
        lines = [f"{name}: {self.good[name]} of {number} good" for name, number in self.presses.items()]
        return "\n".join([*lines, *self.wrong])


SLOW_PRESSES: Final = 4
"""A slow change reaches its end in so many presses; the last one is judged."""


def judge_press(instrument: Instrument, bench: SimulatedScene, press: RandomPress) -> VerdictRecord:
    """The instrument's verdict on one press, between untouched skin under healthy lights before and lifting after."""
    bench.faults.dimmed = {}
    bench.place(None)
    _step(instrument, 16)
    if press.when == "slowly":
        for number in range(1, SLOW_PRESSES):
            reached = number / SLOW_PRESSES
            bench.faults.dimmed = {name: 1.0 + reached * (level - 1.0) for name, level in press.levels.items()}
            _scan(instrument, bench, press.press())
    if press.when != "in contact":
        bench.faults.dimmed = dict(press.levels)
        _step(instrument, 2)
    return _scan(instrument, bench, press.press(), press.levels).verdict


def judge_dusty_press(
    instrument: Instrument, bench: SimulatedScene, press: RandomPress, dust_seed: int, *, under_object: bool
) -> VerdictRecord:
    """The verdict on a press onto dust that fell 1 s before it, after the skin was seen clean, or with the object."""
    bench.faults.dirty = False
    bench.place(None)
    _step(instrument, 16)
    bench.seed = dust_seed
    if not under_object:
        bench.faults.dirty = True
        until_ns = bench.clock.monotonic_ns() + 1_000_000_000
        while bench.clock.monotonic_ns() < until_ns:
            instrument.step()
    bench.faults.dirty = True
    return _scan(instrument, bench, press.press()).verdict


def _scan(
    instrument: Instrument, bench: SimulatedScene, press: Press | None, levels: Mapping[str, float] | None = None
) -> ScanFinished:
    """Press, set the lights' levels if given, push the button, lift, and wait for the verdict."""
    instrument.take_events()
    bench.place(press)
    _step(instrument, 4)
    if levels is not None:
        bench.faults.dimmed = dict(levels)
    bench.schedule_button(ButtonPress(bench.clock.monotonic_ns() + 50_000_000, 0.05))
    _step(instrument, 6)
    bench.place(None)
    for _ in range(300):
        instrument.step()
        for event in instrument.take_events():
            if isinstance(event, ScanFinished):
                return event
    raise AssertionError("no scan came of the push")


def _step(instrument: Instrument, steps: int) -> None:
    for _ in range(steps):
        instrument.step()
