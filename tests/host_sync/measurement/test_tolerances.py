"""Circles, painted masks, tolerances, and recipes that are written as they are read."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from host_sync.cli.main import main
from host_sync.errors import MeasurementError
from host_sync.measurement.circle_and_sphere import find_circle
from host_sync.measurement.geometry import SkinPlaces, painted
from host_sync.measurement.height_samples import StatedScale
from host_sync.measurement.measure import measure_result
from host_sync.measurement.measurement import Measurement
from host_sync.measurement.quantity import Quantity, verdict_of
from host_sync.measurement.recipe import (
    CircleTable,
    LevelTable,
    MaskTable,
    RadiusTable,
    Recipe,
    StepTable,
    ToleranceTable,
    checked,
    read_recipe,
    recipe_text,
)

Write = Callable[..., Path]
SHAPE = (180, 240)
PITCH_UM = 5.0
RIM = CircleTable(name="rim", centre_um=(580.0, 470.0), radius_um=230.0)


def number(found: Measurement, subject: str, name: str) -> Quantity:
    return next(one for one in found.quantities if (one.subject, one.name) == (subject, name))


def hole(depth_um: float = 60.0, radius_um: float = 250.0) -> np.ndarray:
    """A hole with a soft rim about (600, 450) µm, in a plane."""
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]] * PITCH_UM
    away = np.hypot(column - 600.0, row - 450.0) - radius_um
    return -0.5 * depth_um * (1.0 - np.tanh(away / 20.0)) + 0.005 * column


def test_a_circle_is_found_from_one_that_was_drawn_beside_it(write_result: Write) -> None:
    folder = write_result(hole(), error_um=0.2)
    found = measure_result(folder, Recipe(circle=(RIM,)))
    diameter, step = number(found, "rim", "diameter"), number(found, "rim", "step")
    assert diameter.value == pytest.approx(500.0, abs=0.5)
    assert diameter.uncertainty is not None
    assert abs(diameter.value - 500.0) < 3.0 * diameter.uncertainty
    assert step.value == pytest.approx(-60.0, abs=0.5)
    assert number(found, "rim", "centre right").value == pytest.approx(600.0, abs=1.0)
    assert number(found, "rim", "centre down").value == pytest.approx(450.0, abs=1.0)
    assert number(found, "rim", "roundness").value < 3.0


def test_a_circle_across_the_border_counts_where_it_is_seen(write_result: Write) -> None:
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]] * PITCH_UM
    z_um = np.where(np.hypot(column - 60.0, row - 450.0) < 250.0, 30.0, 0.0)
    found = measure_result(
        write_result(z_um), Recipe(circle=(CircleTable(name="a", centre_um=(60.0, 450.0), radius_um=240.0),))
    )
    diameter = number(found, "a", "diameter")
    assert diameter.value == pytest.approx(500.0, abs=2.0)
    assert any("of the circle only" in words for words in diameter.warnings)
    assert 0.3 < diameter.masked_share < 0.5


@pytest.mark.parametrize("shown", ["slope", "dome", "cylinder"])
@pytest.mark.parametrize("place", [(30.0, 20.0, 300.0), (600.0, 450.0, 400.0), (1200.0, 870.0, 300.0)])
def test_a_part_of_a_slope_holds_no_circle(shown: str, place: tuple[float, float, float]) -> None:
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]] * PITCH_UM
    surface = {"slope": 0.04 * column, "dome": -1e-4 * (row**2 + column**2), "cylinder": -1e-4 * column**2}[shown]
    with pytest.raises(MeasurementError, match="no round edge"):
        find_circle(surface.astype(np.float32), SkinPlaces(PITCH_UM), place[:2], place[2])


def test_rays_that_meet_no_edge_are_not_masked(write_result: Write) -> None:
    away = np.arange(SHAPE[1]) * PITCH_UM - 600.0
    z_um = np.where(away < 100.0, hole(), 0.005 * (away + 600.0) - 60.0)
    found = number(measure_result(write_result(z_um), Recipe(circle=(RIM,))), "rim", "diameter")
    assert any("of the circle only" in words for words in found.warnings)
    assert found.masked_share == 0.0


@pytest.mark.parametrize("shown", ["flat", "wave", "noise", "skin", "step"])
def test_without_an_edge_there_is_no_circle_and_without_a_ball_no_radius(
    shown: str, write_result: Write, wave: np.ndarray
) -> None:
    noise = np.random.default_rng(6).standard_normal(SHAPE)
    skin = gaussian_filter(np.random.default_rng(8).standard_normal(SHAPE), 15.0)
    step = 50.0 * (np.arange(SHAPE[1]) > 110.0) + np.zeros(SHAPE)
    surface = {"flat": np.zeros(SHAPE), "wave": wave, "noise": noise, "skin": skin, "step": step}[shown]
    circles = [CircleTable(name=f"c{x}", centre_um=(float(x), 470.0), radius_um=230.0) for x in range(400, 850, 50)]
    radii = [RadiusTable(name=f"r{x}", region_um=(x, 100.0, x + 500.0, 800.0)) for x in (100.0, 300.0, 550.0)]
    found = measure_result(write_result(surface), Recipe(circle=tuple(circles), radius=tuple(radii)))
    assert len(set(found.failed)) == len(circles) + len(radii)
    reasons = {one.subject[0]: one.warnings[0] for one in found.quantities if one.subject != "surface"}
    assert "no round edge" in reasons["c"]
    assert "no sphere" in reasons["r"]


def test_what_is_painted_over_is_not_measured(write_result: Write) -> None:
    z_um = np.zeros(SHAPE)
    z_um[80:100, 50:200] = 500.0
    stroke = MaskTable(points_um=((240.0, 447.0), (1010.0, 447.0)), width_um=150.0)
    found = measure_result(write_result(z_um), Recipe(form="none", mask=(stroke,), parameters=("Sz",)))
    assert number(found, "surface", "Sz").value == 0.0
    share = (770.0 * 150.0 + np.pi * 75.0**2) / (np.prod(SHAPE) * PITCH_UM**2)
    assert number(found, "surface", "Sz").masked_share == pytest.approx(share, rel=0.05)
    dot = MaskTable(points_um=((600.0, 450.0),), width_um=300.0)
    found = measure_result(write_result(np.zeros(SHAPE)), Recipe(mask=(dot,), parameters=("Sz",)))
    share = np.pi * 150.0**2 / (np.prod(SHAPE) * PITCH_UM**2)
    assert number(found, "surface", "Sz").masked_share == pytest.approx(share, rel=0.08)


@pytest.mark.parametrize(
    ("value", "uncertainty", "k", "verdict"),
    [
        (100.0, 5.0, 1, "pass"),
        (100.0, 10.0, 2, "pass"),
        (100.0, 7.0, 1, "undecided"),
        (109.0, 1.0, 1, "undecided"),
        (111.0, 1.0, 1, "undecided"),
        (112.0, 1.0, 1, "fail"),
        (88.0, 2.0, 2, "fail"),
        (100.0, None, 1, "undecided"),
        (None, None, 1, "undecided"),
    ],
)
def test_the_decision_leaves_a_guard_band_on_both_sides(
    value: float | None, uncertainty: float | None, k: int, verdict: str
) -> None:
    quantity = Quantity(
        subject="a", name="b", unit="µm", value=value, uncertainty=uncertainty, coverage_factor=k, offset=None,
        samples=0, masked_share=0.0,
    )  # fmt: skip
    assert verdict_of(quantity, 90.0, 110.0) == verdict
    if value is not None and value > 100.0 and verdict == "fail":
        assert verdict_of(quantity, None, 110.0) == "fail"
        assert verdict_of(quantity, 90.0, None) == "pass"


RECIPE = Recipe(
    name='a "quoted" name \\ with µ, \x7f and\ta tab',
    region_um=(10.0, 20.0, 900.0, 1e-07),
    l_filter_um=250.0,
    parameters=("Sa", "height"),
    spectrum=True,
    step=(StepTable(name="s", from_um=(100.0, 100.0), to_um=(900.0, 100.0), kind="groove"),),
    circle=(RIM,),
    mask=(MaskTable(points_um=((1.0, 2.0), (3.0, 4.0)), width_um=5.0),),
    tolerance=(
        ToleranceTable(number="Sa", high=2.0),
        ToleranceTable(of="rim", number="diameter", low=490.0, high=510.0),
    ),
)


@pytest.mark.parametrize(
    "recipe", [Recipe(), RECIPE, Recipe(level=LevelTable(on="skin"), scale=StatedScale(pixel_pitch_share=0.001))]
)
def test_a_recipe_that_was_written_is_read_as_it_was(recipe: Recipe, tmp_path: Path) -> None:
    path = tmp_path / "recipe.toml"
    path.write_text(recipe_text(recipe))
    assert read_recipe(path) == recipe


@pytest.mark.parametrize(
    ("tolerance", "words"),
    [
        (ToleranceTable(of="rum", number="diameter", low=1.0), "accepted are surface, rim"),
        (ToleranceTable(of="rim", number="diameter"), "needs low, high or both"),
        (ToleranceTable(of="rim", number="diameter", low=2.0, high=1.0), "is not less than"),
    ],
)
def test_limits_that_mean_nothing_are_refused(tolerance: ToleranceTable, words: str) -> None:
    with pytest.raises(MeasurementError, match=words):
        checked(Recipe(circle=(RIM,), tolerance=(tolerance,)), "recipe")
    twice = ToleranceTable(number="Sa", low=1.0)
    with pytest.raises(MeasurementError, match="occurs twice"):
        checked(Recipe(tolerance=(twice, twice)), "recipe")


def test_the_command_prints_verdicts_and_fails_with_them(
    write_result: Write, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write_result(hole(), error_um=0.2)
    recipe, table = tmp_path / "recipe.toml", tmp_path / "table.csv"
    scale = StatedScale(pixel_pitch_share=0.001)
    for high, verdict, code in ((520.0, "pass", 0), (480.0, "fail", 1)):
        limits = ToleranceTable(of="rim", number="diameter", low=400.0, high=high)
        recipe.write_text(recipe_text(Recipe(parameters=("Sa",), circle=(RIM,), tolerance=(limits,), scale=scale)))
        assert main(["measure", str(folder), "--recipe", str(recipe), "--csv", str(table)]) == code
        assert f"{verdict}: 400 to {high:g}" in capsys.readouterr().out
        (row,) = [one for one in csv.DictReader(table.read_text().splitlines()) if one["name"] == "diameter"]
        assert (row["low"], row["high"], row["verdict"]) == ("400", f"{high:g}", verdict)
    recipe.write_text(
        recipe_text(Recipe(circle=(RIM,), tolerance=(ToleranceTable(of="rim", number="width", low=1.0),)))
    )
    assert main(["measure", str(folder), "--recipe", str(recipe), "--json"]) == 1
    assert '"failed":["rim: width"]' in capsys.readouterr().out


def test_a_circle_wider_than_the_field_is_refused_before_it_is_sampled() -> None:
    with pytest.raises(MeasurementError, match="does not fit into a field"):
        find_circle(hole().astype(np.float32), SkinPlaces(PITCH_UM), (580.0, 470.0), 1e7)


def test_a_brush_wider_than_any_line_covers_the_field() -> None:
    for points in (((1.0, 1.0),), ((1.0, 1.0), (50.0, 40.0))):
        assert painted([MaskTable(points_um=points, width_um=1e7)], SHAPE, PITCH_UM).all()


def test_a_doubt_under_which_the_uncertainty_does_not_hold_decides_nothing() -> None:
    sure = Quantity(
        subject="surface", name="Sa", unit="µm", value=5.0, uncertainty=0.1, coverage_factor=1, offset=None, samples=16,
        masked_share=0.0,
    )  # fmt: skip
    doubted = msgspec.structs.replace(sure, warnings=("failed calibration: held-out balls are off",))
    told = msgspec.structs.replace(sure, warnings=("extrapolated slopes: 3 % of the field",))
    assert [verdict_of(one, 4.0, 6.0) for one in (sure, told, doubted)] == ["pass", "pass", "undecided"]


def test_nothing_is_decided_without_the_uncertainty_of_the_pixel_pitch(write_result: Write) -> None:
    limits = (
        ToleranceTable(of="rim", number="diameter", low=400.0, high=520.0),
        ToleranceTable(of="rim", number="step", low=-90.0, high=-30.0),
    )
    recipe = Recipe(circle=(RIM,), tolerance=limits)
    folder = write_result(hole(), error_um=0.2)
    unsure = measure_result(folder, recipe)
    share = 0.01
    sure = measure_result(folder, msgspec.structs.replace(recipe, scale=StatedScale(pixel_pitch_share=share)))
    for name, dependence in (("diameter", 1.0), ("step", 2.0)):
        before, after = number(unsure, "rim", name), number(sure, "rim", name)
        assert before.limits is not None
        assert after.limits is not None
        assert (before.limits.verdict, after.limits.verdict) == ("undecided", "pass")
        assert any("without that of the pixel pitch" in words or "± not known" in words for words in before.warnings)
        assert after.value is not None
        assert (after.uncertainty or 0.0) > 0.7 * dependence * share * abs(after.value)
    measured = write_result(hole(), name="grid", error_um=0.2, height_scale={"pixel_pitch_share": 0.002})
    (verdict,) = {one.limits.verdict for one in measure_result(measured, recipe).quantities if one.limits}
    assert verdict == "pass"
