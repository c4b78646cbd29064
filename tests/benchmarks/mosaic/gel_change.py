"""Dents between two presses of the whole twin on two gels: frames, two calibrations, reconstruction, same spot.

    python -m tests.benchmarks.mosaic.gel_change [--dents 100] [--pairs 500] [--first 0] [--gels 6]

Worn metal as in `same_spot`, shifted and turned as by a hand. Each gel has its own coat, thickness and pigment
and is calibrated by twelve presses of a ball. Frames have 272 × 364 pixels of 48 µm with the charge of 16 pixels of
the reference twin, as if its frames were binned by four. Dents are Gaussians, 0.3 to 1 mm across at half their depth.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path
from typing import Final

import msgspec
import numpy as np

from device.acquisition.calibrate import calibrate
from device.acquisition.capture import CaptureSettings, capture
from device.imaging.flat_field import demosaic
from device.store.store import BundleStore
from device.surface import HeightMap
from hal.board_profile import BoardProfile
from hal.clock import VirtualClock
from hal.simulator.bench import build
from hal.simulator.hardware import twin_hardware
from hal.simulator.scene import Press
from hal.simulator.surfaces import Surface
from host_sync.calibration_file.calibrator import calibration_of
from host_sync.reconstruction.pipeline import Reconstruction, reconstruct
from host_sync.same_spot.changes import WIDTH_TO_DIAMETER
from tests.benchmarks.mosaic.ruler import ReliefMap
from tests.benchmarks.mosaic.same_spot import DEPTH_UM, Dented, Outcome, judged, metal_map, write, write_figures
from tests.benchmarks.speed.specimen import BALL_RADIUS_MM, twin_of

SHAPE: Final = (272, 364)
PITCH_MM: Final = 0.048
BINNED: Final = 16
PIGMENT: Final = 0.01
PRESSED_MM: Final = 0.4


class Gel:
    """A twin with one gel, calibrated."""

    def __init__(self, number: int, folder: Path) -> None:
        self._bench = build(_profile(number), VirtualClock(start_ns=5_000_000_000, wall_start_s=1_000.0))
        self._hardware = twin_hardware(self._bench)
        with self._hardware:
            store = BundleStore(folder, self._hardware.clock, boot_id="b0075e1f")
            outcome = calibrate(self._hardware, store, BALL_RADIUS_MM, lambda _: None)
        self._calibration = calibration_of(outcome.bundle)

    def press(self, surface: Surface, centre_mm: tuple[float, float], turn_rad: float, depth_mm: float) -> HeightMap:
        """The reconstructed surface of one press."""
        return self.reconstructed(surface, centre_mm, turn_rad, depth_mm).height

    def reconstructed(
        self, surface: Surface, centre_mm: tuple[float, float], turn_rad: float, depth_mm: float
    ) -> Reconstruction:
        """The same with its uncertainty."""
        with self._hardware:
            self._bench.place(Press(surface, centre_mm, turn_rad, depth_mm))
            frame = capture(self._hardware, CaptureSettings.of_board(self._hardware))
            self._bench.place(None)
        return reconstruct(demosaic(frame), self._calibration, "press")


def _profile(number: int) -> BoardProfile:
    """The reference twin with frames as if binned, and a gel of its own."""
    profile = twin_of(SHAPE)
    sensor, twin = profile.sensor, profile.twin
    random = np.random.default_rng(number)
    return msgspec.structs.replace(
        profile,
        sensor=msgspec.structs.replace(
            sensor,
            full_well_e=sensor.full_well_e * BINNED,
            read_noise_e=sensor.read_noise_e * BINNED**0.5,
        ),
        twin=msgspec.structs.replace(
            twin,
            yield_e_per_ma_ms=twin.yield_e_per_ma_ms * BINNED,
            skin=("diffuse", "flake")[number % 2],
            seed=number,
            pigment_contrast=PIGMENT,
        ),
        gel=msgspec.structs.replace(profile.gel, slab_thickness_mm=2.5 + random.normal(0.0, 0.05)),
    )


def outcome(metal: ReliefMap, gels: list[Gel], seed: int, depth_um: float) -> Outcome:
    """What is found in one pair with a dent, or without if its depth is zero."""
    random = np.random.default_rng((seed, int(depth_um > 0.0)))
    one, other = random.choice(len(gels), 2, replace=False)
    centre = random.uniform(-1.0, 1.0, 2)
    shift = random.normal(0.0, 0.5, 2)
    turn = random.uniform(-0.5, 0.5)
    turned = turn + np.radians(random.normal(0.0, 3.0))
    depths = PRESSED_MM * random.uniform(0.9, 1.1, 2)
    at = random.uniform(-2.5, 2.5, 2)
    width_mm = random.uniform(0.3, 1.0) / WIDTH_TO_DIAMETER
    first = gels[one].press(metal, (float(centre[0]), float(centre[1])), float(turn), float(depths[0]))
    after = Dented(metal, at[0], at[1], 1e-3 * depth_um, width_mm) if depth_um else metal
    moved = centre + shift
    second = gels[other].press(after, (float(moved[0]), float(moved[1])), float(turned), float(depths[1]))
    cosine, sine = np.cos(turn), np.sin(turn)
    right_mm, down_mm = cosine * at[0] - sine * at[1] + centre[0], sine * at[0] + cosine * at[1] + centre[1]
    middle_mm = [0.5 * (count - 1) * PITCH_MM for count in SHAPE]
    return judged(first, second, (middle_mm[0] + down_mm, middle_mm[1] + right_mm))


def main(arguments: list[str] | None = None) -> int:
    """Print every figure."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--dents", type=int, default=100)
    parser.add_argument("--pairs", type=int, default=500)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--gels", type=int, default=6)
    options = parser.parse_args(arguments)
    started = time.perf_counter()
    metal = metal_map()
    with tempfile.TemporaryDirectory() as folder:
        gels = [Gel(options.first + number, Path(folder) / f"{number}") for number in range(options.gels)]
    for depth_um, count in ((DEPTH_UM, options.dents), (0.0, options.pairs)):
        seeds = range(options.first, options.first + count)
        write_figures([outcome(metal, gels, seed, depth_um) for seed in seeds], depth_um)
    write(f"{time.perf_counter() - started:.0f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
