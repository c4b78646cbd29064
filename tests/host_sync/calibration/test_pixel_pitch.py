"""The pitch of grids whose pose is known: its error must be what its uncertainty says."""

from __future__ import annotations

import numpy as np
import pytest

from device.balls.sphere import Ball
from device.errors import CalibrationError
from host_sync.calibration.balls import GridSpacing
from host_sync.calibration.lattice import find_lattice
from host_sync.calibration.pixel_pitch import PitchReading, join_readings, read_pitch

SHAPE = (1000, 1200)
PITCH_UM = 10.0
GRID = GridSpacing(pitch_mm=1.2)
STEP_PX = 120.0


def read(
    seed: int, noise_px: float = 0.3, tilt: float = 0.0, bend: float = 0.0, grid: GridSpacing = GRID
) -> PitchReading:
    """The reading of a grid of 9 by 7 balls around the frame's middle, turned at random."""
    random = np.random.default_rng(seed)
    turn = random.uniform(-0.2, 0.2)
    across, down = np.meshgrid(np.arange(-4, 5), np.arange(-3, 4))
    places = np.stack([across, down], axis=-1).reshape(-1, 2)
    matrix = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    flat = STEP_PX * places @ matrix.T / (1.0 + places @ [tilt, tilt])[:, None]
    flat *= 1.0 + bend * (flat**2).sum(axis=1, keepdims=True) / (0.5 * np.hypot(*SHAPE)) ** 2
    points = flat + np.array([599.5, 499.5]) + random.normal(0.0, noise_px, flat.shape)
    lattice = find_lattice(points)
    assert lattice is not None
    return read_pitch("grid", lattice, [Ball(c, r, 20.0, 30.0) for c, r in points], grid, SHAPE)


def test_the_scatter_is_calibrated() -> None:
    readings = [read(seed) for seed in range(24)]
    score = np.array([(reading.pitch_um - PITCH_UM) / reading.scatter_um for reading in readings])
    assert 0.5 <= (np.abs(score) < 1.0).mean() <= 0.85
    assert abs(score.mean()) < 0.5
    assert all(0.0 < reading.scatter_um < 2e-4 * PITCH_UM for reading in readings)
    assert all(reading.sigma_um > reading.bias_um > 0.0 for reading in readings)


@pytest.mark.parametrize(
    ("tilt", "bend", "model"),
    [(0.0, 0.0, "similarity"), (0.004, 0.0, "homography"), (0.0, 0.02, "similarity and radial distortion")],
)
def test_the_pose_is_as_rich_as_held_out_balls_bear(tilt: float, bend: float, model: str) -> None:
    chosen = [read(seed, tilt=tilt, bend=bend).pose.model.name for seed in range(5)]
    assert chosen.count(model) >= 4
    held_out = read(0, tilt=tilt, bend=bend).pose.held_out_px
    assert held_out[model] == pytest.approx(0.3, abs=0.08)
    if model != "similarity":
        assert held_out["similarity"] > 2.0 * held_out[model]


def test_the_pitch_varies_over_a_field_in_perspective_and_not_over_a_flat_one() -> None:
    flat, tilted = read(1), read(1, tilt=0.004)
    assert flat.most_um - flat.least_um < 1e-9
    assert tilted.most_um / tilted.least_um - 1.0 == pytest.approx(3.0 * 2.0 * 0.004 * 7.0 / 2.0, rel=0.3)


def test_a_true_pitch_is_not_contradicted_and_a_wrong_one_is_named() -> None:
    readings = [read(seed) for seed in range(3)]
    assert join_readings(PITCH_UM, readings).disagreement == ""
    pitch = join_readings(1.02 * PITCH_UM, readings)
    assert pitch.pitch_um == pytest.approx(PITCH_UM, rel=2e-4)
    assert "10.2 µm is +2.0" in pitch.disagreement
    with pytest.raises(CalibrationError, match=r"10 ± 0\.\d+ µm, and 12 µm is stated \(\+20%\)"):
        join_readings(12.0, readings)


def test_readings_that_differ_are_less_sure_and_a_bias_does_not_average_out() -> None:
    same = [read(seed) for seed in range(4)]
    assert join_readings(PITCH_UM, same).sigma_um > same[0].bias_um
    other = read(9, grid=GridSpacing(1.01 * GRID.pitch_mm))
    assert (
        join_readings(PITCH_UM, [*same, other]).sigma_um
        > 0.0015 * PITCH_UM
        > 1.3 * join_readings(PITCH_UM, same).sigma_um
    )


def test_the_grids_own_tolerance_is_in_the_uncertainty() -> None:
    loose = read(2, grid=GridSpacing(GRID.pitch_mm, tolerance_mm=0.05 * GRID.pitch_mm))
    assert join_readings(PITCH_UM, [loose]).sigma_um == pytest.approx(0.05 / np.sqrt(3.0) * PITCH_UM, rel=0.02)
