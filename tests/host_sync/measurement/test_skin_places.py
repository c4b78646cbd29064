"""What stands near the camera is measured as large as it is: surfaces traced along the camera's rays."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from device.surface import HeightMap
from host_sync.measurement.geometry import SkinPlaces
from host_sync.measurement.measure import measure
from host_sync.measurement.recipe import (
    AngleTable,
    CircleTable,
    DistanceTable,
    LevelTable,
    RadiusTable,
    Recipe,
    StepTable,
    VolumeTable,
)
from host_sync.results.reader import ResultSurface
from host_sync.results.record import ResultRecord

PITCH_UM = 20.0
SHAPE = (300, 400)
PUPIL_MM = 25.0
ALL_UM = (0.0, 0.0, 7980.0, 5980.0)

Surface = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]]
"""Height, µm, at places right and down of the middle of the field, µm."""


def seen(of: Surface) -> NDArray[np.float32]:
    """The height map of a surface: where rays of the pixels meet it, found by going down them."""
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    x, y = (column - 0.5 * (SHAPE[1] - 1)) * PITCH_UM, (row - 0.5 * (SHAPE[0] - 1)) * PITCH_UM
    low, high = np.full(SHAPE, -3000.0), np.full(SHAPE, 3000.0)
    for _ in range(50):
        z = 0.5 * (low + high)
        share = 1.0 - z / (1e3 * PUPIL_MM)
        is_above = z > of(x * share, y * share)
        low, high = np.where(is_above, low, z), np.where(is_above, z, high)
    return (0.5 * (low + high)).astype(np.float32)


def numbers(of: Surface, recipe: Recipe, pupil_mm: float | None) -> dict[str, float]:
    return numbers_on(seen(of), recipe, pupil_mm)


def numbers_on(z_um: NDArray[np.float32], recipe: Recipe, pupil_mm: float | None) -> dict[str, float]:
    rows, columns = SHAPE
    record = ResultRecord(name="a", rows=rows, columns=columns, pixel_pitch_um=PITCH_UM, pupil_height_mm=pupil_mm)
    surface = ResultSurface(Path("a"), record, HeightMap(z_um, PITCH_UM), stated=())
    return {one.name: one.value for one in measure(surface, recipe).quantities if one.value is not None}


def plate(edge_um: float, top_um: float) -> Surface:
    return lambda x, y: top_um / (1.0 + np.exp((np.hypot(x, y) - edge_um) / 15.0))


CASES: dict[str, tuple[Surface, Recipe, str, float, float]] = {
    "radius": (
        lambda x, y: np.sqrt(np.maximum(3000.0**2 - (x - 900.0) ** 2 - (y + 700.0) ** 2, 1000.0**2)) - 2000.0,
        Recipe(radius=(RadiusTable(name="ball", region_um=(3500.0, 900.0, 6300.0, 3600.0)),)),
        "radius",
        3000.0,
        0.03,
    ),
    "distance": (
        lambda x, y: 1000.0 + 0.0 * x,  # noqa: ARG005 - a level plate
        Recipe(distance=(DistanceTable(name="d", from_um=(1000.0, 1000.0), to_um=(7000.0, 5000.0)),)),
        "along the skin",
        0.96 * float(np.hypot(6000.0, 4000.0)),
        0.03,
    ),
    "angle": (
        lambda x, y: 1200.0 - 0.4 * np.abs(x - 1000.0),  # noqa: ARG005 - a roof along the columns
        Recipe(
            angle=(
                AngleTable(
                    name="a", first_um=(1000.0, 500.0, 4500.0, 5000.0), second_um=(5500.0, 500.0, 7900.0, 5000.0)
                ),
            )
        ),
        "angle",
        2.0 * float(np.degrees(np.arctan(0.4))),
        0.01,
    ),
    "volume": (
        lambda x, y: 1000.0 - 300.0 * np.exp(-(x**2 + y**2) / (2.0 * 400.0**2)),
        Recipe(volume=(VolumeTable(name="pit", region_um=ALL_UM, border_um=200.0),)),
        "void volume",
        300.0 * 2.0 * np.pi * 400.0**2,
        0.05,
    ),
    "volume on a slope": (
        lambda x, y: 900.0 + 0.1 * x - 300.0 * np.exp(-(x**2 + y**2) / (2.0 * 400.0**2)),
        Recipe(volume=(VolumeTable(name="pit", region_um=ALL_UM, border_um=200.0),)),
        "void volume",
        300.0 * 2.0 * np.pi * 400.0**2,
        0.02,
    ),
    "levelled distance": (
        lambda x, y: 1000.0 + 0.05 * x + 0.0 * y,
        Recipe(
            level=LevelTable(on="plane", regions_um=(ALL_UM,)),
            distance=(DistanceTable(name="d", from_um=(1000.0, 1000.0), to_um=(7000.0, 5000.0)),),
        ),
        "along the skin",
        6923.0,
        0.03,
    ),
    "circle on a slope": (
        lambda x, y: plate(1200.0, 400.0)(x - 800.0, y) + 700.0 + 0.15 * x,
        Recipe(circle=(CircleTable(name="c", centre_um=(4825.0, 2990.0), radius_um=1240.0),)),
        "diameter",
        2400.0,
        0.02,
    ),
    "centre of a circle on a slope": (
        lambda x, y: plate(1200.0, 400.0)(x - 800.0, y) + 700.0 + 0.15 * x,
        Recipe(circle=(CircleTable(name="c", centre_um=(4825.0, 2990.0), radius_um=1240.0),)),
        "centre right",
        3990.0 + 800.0,
        0.005,
    ),
    "circle": (
        plate(1500.0, 800.0),
        Recipe(circle=(CircleTable(name="c", centre_um=(3990.0, 2990.0), radius_um=1520.0),)),
        "diameter",
        3000.0,
        0.015,
    ),
    "ridge": (
        plate(1500.0, 800.0),
        Recipe(
            step=(StepTable(name="s", from_um=(500.0, 2990.0), to_um=(7500.0, 2990.0), width_um=60.0, kind="ridge"),)
        ),
        "width",
        3000.0,
        0.01,
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_raised_skin_is_measured_as_large_as_it_is(name: str) -> None:
    of, recipe, quantity, truth, wrong = CASES[name]
    near = numbers(of, recipe, PUPIL_MM)[quantity]
    assert near == pytest.approx(truth, rel=2e-3)
    far = numbers(of, recipe, None)[quantity]
    assert abs(far / truth - 1.0) > wrong


def test_a_sphere_taken_off_leaves_nothing_of_itself() -> None:
    of = CASES["radius"][0]
    recipe = Recipe(form="sphere", region_um=(3500.0, 900.0, 6300.0, 3600.0), parameters=("Sz",))
    assert numbers(of, recipe, PUPIL_MM)["Sz"] < 0.1
    assert numbers(of, recipe, None)["Sz"] > 0.5


def test_masked_skin_beside_an_edge_leaves_the_width_as_it_is() -> None:
    of, recipe, quantity, _, _ = CASES["ridge"]
    z_um = seen(of)
    z_um[:, 190:200] = np.nan
    assert numbers_on(z_um, recipe, PUPIL_MM)[quantity] == pytest.approx(3000.0, rel=2e-3)


def test_far_cameras_see_pixels_where_they_are() -> None:
    z_um = np.full(SHAPE, 1000.0, np.float32)
    across_um, down_um = SkinPlaces(PITCH_UM).at(z_um)
    assert across_um[0, -1] == pytest.approx((SHAPE[1] - 1) * PITCH_UM)
    assert down_um[-1, 0] == pytest.approx((SHAPE[0] - 1) * PITCH_UM)
