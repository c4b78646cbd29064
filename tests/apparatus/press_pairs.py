"""Pairs of presses of one object as hands make them: shifted, turned, of other depth; and what lies between them.

The twin's skin is draped over the object. Its slopes get errors as a calibration leaves them (pixel noise, patches, a
gain that changes over the field) and are integrated.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from device.align import Pose
from device.surface import Float32Array, HeightMap, integrate_dct
from hal.simulator.elastomer import drape
from hal.simulator.surfaces import Block, Coin, Groove, Plane, Sinusoid, Sphere, SphereGrid, Step, Surface, Texture

SHAPE: Final = (272, 364)
PITCH_MM: Final = 0.048
THICKNESS_MM: Final = 2.5
PATCH_PX: Final = 12.0
FLANK: Final = 0.7


@dataclass(frozen=True, slots=True)
class Prism:
    """A straight edge along y with two flanks and a blunt top, `half_length_mm` to either side.

    scratch_mm : depth of the scratches across it that grinding left
    """

    half_length_mm: float
    scratch_mm: float = 0.0

    def height_mm(self, x_mm: np.ndarray, y_mm: np.ndarray) -> np.ndarray:
        flank = -FLANK * np.abs(x_mm)
        blunt = np.where(flank > -0.05, -((FLANK * x_mm) ** 2) / 0.1 - 0.025, flank)
        inside = (np.abs(y_mm) < self.half_length_mm) & (np.abs(x_mm) < 4.0)
        places = np.random.default_rng(5).uniform(-8.0, 8.0, 24)
        scratches = sum(np.exp(-(((y_mm - place) / 0.12) ** 2)) for place in places) * self.scratch_mm
        return np.where(inside, blunt - scratches, np.nan)


_BODY: Final = Block(4.5, 3.5)
OBJECTS: Final[dict[str, tuple[Surface, float]]] = {
    "sphere": (Sphere(3.0), 1.0),
    "sphere grid": (SphereGrid(1.0, 2.5, 2), 0.45),
    "plane": (Plane(Block(3.0, 2.5), 0.05, 0.03), 0.6),
    "sinusoid": (Sinusoid(Block(5.0, 3.5), 1.5, 0.06), 0.45),
    "groove": (Groove(_BODY, 0.8, 0.2, 0.12), 0.5),
    "step": (Step(_BODY, 0.1, 0.15), 0.5),
    "coin": (Coin(5.0, 0.18, 0.18), 0.5),
    "texture": (Texture(_BODY, 0.012, 0.8, 0.4), 0.45),
    "prism": (Prism(30.0), 0.5),
    "long groove": (Groove(Block(30.0, 30.0), 0.8, 0.2, 0.12), 0.35),
}
"""Objects with the depth of a usual press, mm; the last two slide along themselves."""


@dataclass(frozen=True, slots=True)
class Hand:
    """Where and how deep an object is pressed: origin (x right, y up), turn counter-clockwise, depth."""

    x_mm: float
    y_mm: float
    turn_rad: float
    depth_mm: float


@dataclass(frozen=True, slots=True, eq=False)
class PressPair:
    """Two presses, and the true displacement of the object from the first to the second."""

    name: str
    first: HeightMap
    second: HeightMap
    truth: Pose


def press(
    surface: Surface, hand: Hand, random: np.random.Generator, noise: tuple[float, float] = (0.02, 0.01)
) -> HeightMap:
    """The height map of one press.

    noise : standard deviations of slope errors from pixel to pixel, and in patches
    """
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float64)
    x = (column - (SHAPE[1] - 1) / 2) * PITCH_MM - hand.x_mm
    y = ((SHAPE[0] - 1) / 2 - row) * PITCH_MM - hand.y_mm
    cosine, sine = np.cos(hand.turn_rad), np.sin(hand.turn_rad)
    thing = surface.height_mm(cosine * x + sine * y, cosine * y - sine * x) + hand.depth_mm
    skin = drape(thing, PITCH_MM, THICKNESS_MM).height_mm
    slopes = []
    for slope in np.gradient(skin, PITCH_MM):
        error = noise[0] * random.standard_normal(SHAPE) + noise[1] * _patches(random)
        slopes.append((slope * (1.0 + 0.02 * _patches(random)) + error).astype(np.float32))
    z_um = integrate_dct(slopes[1], slopes[0], 1e3 * PITCH_MM)
    return HeightMap((z_um - np.median(z_um[:20])).astype(np.float32), 1e3 * PITCH_MM)


def _patches(random: np.random.Generator) -> Float32Array:
    field = cv2.GaussianBlur(random.standard_normal(SHAPE).astype(np.float32), (0, 0), PATCH_PX)
    return np.asarray(field / field.std(), np.float32)


def displacement(first: Hand, second: Hand) -> Pose:
    """The object's displacement between two presses, at the middle of the field."""
    turn = second.turn_rad - first.turn_rad
    cosine, sine = np.cos(turn), np.sin(turn)
    x = second.x_mm - cosine * first.x_mm + sine * first.y_mm
    y = second.y_mm - sine * first.x_mm - cosine * first.y_mm
    return Pose(float(-y / PITCH_MM), float(x / PITCH_MM), -turn)


def hand_pairs(count: int, seed: int) -> Iterator[PressPair]:
    """Pairs of every object in turn: some tenths of a millimetre and a few degrees apart, 0.7 to 1.15 of its depth."""
    random = np.random.default_rng(seed)
    for number in range(count):
        name = list(OBJECTS)[number % len(OBJECTS)]
        surface, depth_mm = OBJECTS[name]
        x, y = random.uniform(-1.0, 1.0, 2)
        turn = random.uniform(-0.5, 0.5)
        dx, dy = random.normal(0.0, 0.6, 2)
        depths = depth_mm * random.uniform(0.7, 1.15, 2)
        first = Hand(x, y, turn, depths[0])
        second = Hand(x + dx, y + dy, turn + np.radians(random.normal(0.0, 3.0)), depths[1])
        maps = [press(surface, hand, random) for hand in (first, second)]
        yield PressPair(name, maps[0], maps[1], displacement(first, second))


def depth_pairs(surface: Surface, slide_mm: float, seed: int) -> Iterator[PressPair]:
    """All pairs of four depths of one object, each press `slide_mm` further along the object's y than the last."""
    random = np.random.default_rng(seed)
    turn = 0.35
    hands = [
        Hand(-slide_mm * number * np.sin(turn), slide_mm * number * np.cos(turn), turn, depth_mm)
        for number, depth_mm in enumerate((0.3, 0.4, 0.5, 0.65))
    ]
    maps = [press(surface, hand, random) for hand in hands]
    for one in range(4):
        for other in range(one + 1, 4):
            yield PressPair(f"{one} and {other}", maps[one], maps[other], displacement(hands[one], hands[other]))
