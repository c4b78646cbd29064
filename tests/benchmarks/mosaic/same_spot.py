"""Dents between two presses of one object, and false alarms between presses without any.

    python -m tests.benchmarks.mosaic.same_spot [--dents 100] [--pairs 500] [--first 0] [--depth-um 5]

The twin's skin is draped over worn metal, shifted by half a millimetre and turned by three degrees as by a hand,
pressed to another depth. Slopes get the errors of two calibrations: noise, patches, gains that change over the field
by 2 %. Their sizes are those of the twin's own reconstructions with the worst of its skins, of a textured specimen
against its truth, on this grid. The second gel reads all slopes another 1 % higher or lower.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from device.surface import Float64Array, HeightMap
from hal.simulator.surfaces import Surface
from host_sync.errors import RegistrationRefused
from host_sync.registration.difference import difference
from host_sync.same_spot.changes import LIMIT, changes

sys.path.insert(0, str(Path(__file__).parents[2] / "apparatus"))

from press_pairs import PITCH_MM, SHAPE, Hand, press

from tests.benchmarks.mosaic.ruler import GRAIN_MM, ReliefMap

DEPTH_UM: Final = 5.0
WIDTH_MM: Final = 0.25
"""Standard deviation of the dent's Gaussian."""

FOUND_MM: Final = 0.3
GAIN: Final = 0.01
NOISE: Final = (0.004, 0.003)
"""Slope errors from pixel to pixel, and in patches."""


@dataclass(frozen=True, slots=True)
class Dented:
    """A surface with one dent, a Gaussian of standard deviation `width_mm`."""

    surface: Surface
    x_mm: float
    y_mm: float
    depth_mm: float
    width_mm: float = WIDTH_MM

    def height_mm(self, x_mm: Float64Array, y_mm: Float64Array) -> Float64Array:
        """Height (mm)."""
        square = ((x_mm - self.x_mm) ** 2 + (y_mm - self.y_mm) ** 2) / self.width_mm**2
        return np.asarray(self.surface.height_mm(x_mm, y_mm) - self.depth_mm * np.exp(-0.5 * square))


@dataclass(frozen=True, slots=True)
class Outcome:
    """One pair: largest score, number of changes, whether the dent is one of them, its height (µm); or refused."""

    highest: float = 0.0
    count: int = 0
    hit: bool = False
    height_um: float = float("nan")
    sigma_um: float = float("nan")
    refused: bool = False


def metal_map() -> ReliefMap:
    """Worn metal: hills of 30 µm over millimetres, and roughness of a few µm down to 0.2 mm."""
    random = np.random.default_rng(21)
    shape = (round(22.0 / GRAIN_MM), round(26.0 / GRAIN_MM))
    z_mm = np.zeros(shape, np.float32)
    for size_mm, height_mm in ((1.2, 0.03), (0.4, 0.008), (0.15, 0.002)):
        field = cv2.GaussianBlur(random.standard_normal(shape).astype(np.float32), (0, 0), size_mm / GRAIN_MM)
        z_mm += np.float32(height_mm / field.std()) * field
    return ReliefMap(z_mm - z_mm.max())


def outcome(metal: ReliefMap, seed: int, depth_um: float) -> Outcome:
    """What is found in one pair with a dent, or without if its depth is zero."""
    random = np.random.default_rng((seed, int(depth_um > 0.0)))
    hands = []
    x, y = random.uniform(-1.0, 1.0, 2)
    turn = random.uniform(-0.5, 0.5)
    dx, dy = random.normal(0.0, 0.5, 2)
    for shift_x, shift_y, turned in ((0.0, 0.0, 0.0), (dx, dy, float(np.radians(random.normal(0.0, 3.0))))):
        hands.append(Hand(x + shift_x, y + shift_y, turn + turned, 0.4 * random.uniform(0.9, 1.1)))
    at = random.uniform(-2.5, 2.5, 2)
    first = press(metal, hands[0], random, NOISE)
    second = press(Dented(metal, at[0], at[1], 1e-3 * depth_um) if depth_um else metal, hands[1], random, NOISE)
    second = HeightMap(second.z_um * np.float32(1.0 + random.normal(0.0, GAIN)), second.pitch_um)
    cosine, sine = np.cos(turn), np.sin(turn)
    on_x, on_y = cosine * at[0] - sine * at[1] + x, sine * at[0] + cosine * at[1] + y
    place = ((0.5 * (SHAPE[0] - 1) - on_y / PITCH_MM) * PITCH_MM, (0.5 * (SHAPE[1] - 1) + on_x / PITCH_MM) * PITCH_MM)
    return judged(first, second, place)


def judged(first: HeightMap, second: HeightMap, place_mm: tuple[float, float]) -> Outcome:
    """What is found in one pair.

    place_mm : row and column (mm) of the dent on the first press, if there is one
    """
    try:
        rest = difference(first, second)
    except RegistrationRefused:
        return Outcome(refused=True)
    found = changes(first, rest)
    for one in found.found:
        away_mm = np.hypot(one.row_um * 1e-3 - place_mm[0], one.column_um * 1e-3 - place_mm[1])
        if away_mm < FOUND_MM and one.height_um < 0.0:
            return Outcome(found.highest, len(found.found), True, one.height_um, one.sigma_um)
    return Outcome(found.highest, len(found.found))


def write(line: str) -> None:
    """Write one line."""
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def write_figures(every: list[Outcome], depth_um: float) -> None:
    """Write the figures of all pairs with a dent, or without one if its depth is zero."""
    seen = [one for one in every if not one.refused]
    write(f"{'with' if depth_um else 'without'} a dent: {len(every)} pairs, {len(every) - len(seen)} not registered")
    scores = np.sort([one.highest for one in seen])
    if not depth_um:
        alarms = sum(one.count > 0 for one in seen)
        write(f"false alarms: {alarms} of {len(seen)} (limit {LIMIT:g}); highest scores {np.round(scores[-8:], 1)}")
        return
    hits = [one for one in seen if one.hit]
    write(f"found: {len(hits)} of {len(every)}; scores {np.round(scores[:8], 1)} …")
    if hits:
        heights = np.array([one.height_um for one in hits])
        pulls = (heights + depth_um) / np.array([one.sigma_um for one in hits])
        write(f"height {heights.mean():.2f} ± {heights.std():.2f} µm of {-depth_um:g}")
        write(f"its error over its σ: {np.sqrt(np.mean(pulls**2)):.2f}")
    write(f"more than the dent in {sum(one.count > one.hit for one in seen)}")


def main(arguments: list[str] | None = None) -> int:
    """Print every figure."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--dents", type=int, default=100)
    parser.add_argument("--pairs", type=int, default=500)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--depth-um", type=float, default=DEPTH_UM)
    options = parser.parse_args(arguments)
    started = time.perf_counter()
    metal = metal_map()
    for depth_um, count in ((options.depth_um, options.dents), (0.0, options.pairs)):
        every = [outcome(metal, seed, depth_um) for seed in range(options.first, options.first + count)]
        write_figures(every, depth_um)
    write(f"{time.perf_counter() - started:.0f} s")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
