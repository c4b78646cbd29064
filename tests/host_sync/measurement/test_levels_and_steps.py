"""Levelling on what a person chose, steps that do not know their line's length, and measurands that are not there."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from host_sync.cli.main import main
from host_sync.errors import MeasurementError
from host_sync.measurement.measure import measure_result
from host_sync.measurement.measurement import Measurement
from host_sync.measurement.quantity import Quantity
from host_sync.measurement.recipe import DistanceTable, LevelTable, Recipe, StepTable, checked
from host_sync.profile.profile_line import Profile
from host_sync.profile.step_height import (
    StepEdges,
    StepKind,
    definition_sigma_um,
    find_edges,
    require_step,
    step_height_um,
)
from host_sync.results.field_file import write_mask

Write = Callable[..., Path]
SHAPE = (180, 240)
PITCH_UM = 5.0


def number(found: Measurement, subject: str, name: str) -> Quantity:
    return next(one for one in found.quantities if (one.subject, one.name) == (subject, name))


def tilted_block() -> np.ndarray:
    """A block 40 µm high in the middle of a field that is tilted by 0.02 down and -0.01 across."""
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float64)
    block = np.where((abs(row - 90) < 40) & (abs(column - 120) < 50), 40.0, 0.0)
    return block + PITCH_UM * (0.02 * row - 0.01 * column) + 7.0


def edge(flank_px: float, rise_um: float = 200.0) -> np.ndarray:
    """A step with the flank of a pressed gel, on a surface that sags by a few percent of it far from the edge."""
    column = np.arange(SHAPE[1]) - 119.5
    sag = 0.05 * rise_um * np.sign(column) * (1.0 - np.exp(-np.abs(column) / 150.0))
    profile = 0.5 * rise_um * np.tanh(column / flank_px) - sag
    return np.broadcast_to(profile, SHAPE).astype(np.float32)


LEVELS = {
    "points": LevelTable(on="points", points_um=((50.0, 50.0), (1100.0, 60.0), (80.0, 800.0))),
    "plane": LevelTable(on="plane", regions_um=((0.0, 0.0, 1150.0, 150.0), (0.0, 750.0, 1150.0, 890.0))),
    "skin": LevelTable(on="skin", regions_um=((0.0, 0.0, 300.0, 890.0), (900.0, 0.0, 1190.0, 890.0))),
}


@pytest.mark.parametrize("kind", sorted(LEVELS))
def test_what_was_chosen_is_level(kind: str, write_result: Write) -> None:
    folder = write_result(tilted_block(), error_um=0.05)
    found = measure_result(folder, Recipe(form="none", level=LEVELS[kind], parameters=("height",)))
    assert abs(float(np.median(found.height.z_um[:30]))) < 0.01
    assert float(np.median(found.height.z_um[60:120, 80:160])) == pytest.approx(40.0, abs=0.01)
    (note,) = [one for one in found.notes if one.startswith("levelled on")]
    assert "median ± of a height changes from" in note


def test_a_line_levels_along_itself_alone(write_result: Write) -> None:
    level = LevelTable(on="line", points_um=((0.0, 50.0), (1190.0, 50.0)))
    found = measure_result(write_result(tilted_block()), Recipe(form="none", level=level, parameters=("height",)))
    z_um = found.height.z_um
    assert abs(float(z_um[10, 20] - z_um[10, 220])) < 0.01
    assert abs(float(z_um[10, 100])) < 0.01
    assert float(z_um[20, 20] - z_um[10, 20]) == pytest.approx(0.02 * 10 * PITCH_UM, abs=0.01)


def test_the_mask_that_reconstruction_wrote_is_the_untouched_skin(write_result: Write) -> None:
    folder = write_result(tilted_block())
    skin = np.zeros(SHAPE, np.bool_)
    skin[:30] = True
    write_mask(folder / "untouched.png", skin)
    found = measure_result(folder, Recipe(form="none", level=LevelTable(on="skin"), parameters=("height",)))
    assert abs(float(np.median(found.height.z_um[:30]))) < 0.01
    assert any("untouched skin, 17% of the field" in note for note in found.notes)


def test_levelling_takes_a_common_tilt_out_of_the_uncertainty(write_result: Write) -> None:
    folder = write_result(tilted_block(), error_um=5.0)
    recipe = Recipe(
        form="none", parameters=("height",), distance=(DistanceTable(name="a", from_um=(50, 50), to_um=(600, 450)),)
    )
    plain = number(measure_result(folder, recipe), "a", "in height")
    levelled = Recipe(
        **{name: getattr(recipe, name) for name in ("form", "parameters", "distance")}, level=LEVELS["points"]
    )
    other = number(measure_result(folder, levelled), "a", "in height")
    assert plain.uncertainty is not None
    assert other.uncertainty is not None
    assert other.uncertainty != pytest.approx(plain.uncertainty, rel=0.02)


@pytest.mark.parametrize(
    ("level", "words"),
    [
        (LevelTable(on="points", points_um=((0, 0), (1, 1))), "three points or more"),
        (LevelTable(on="line", points_um=((0, 0),)), "two ends"),
        (LevelTable(on="plane"), "one region or more"),
        (LevelTable(on="skin", points_um=((0, 0),)), "untouched skin has none"),
    ],
)
def test_a_level_that_does_not_fit_is_refused(level: LevelTable, words: str) -> None:
    with pytest.raises(MeasurementError, match=words):
        checked(Recipe(level=level), "recipe.toml")


def test_points_on_one_line_are_refused(write_result: Write) -> None:
    points = ((100.0, 100.0), (200.0, 200.0), (300.0, 300.0))
    level = LevelTable(on="points", points_um=tuple((x + 400, 450.0) for x, _ in points))
    tall = LevelTable(on="points", points_um=((-500.0, 0.0), *level.points_um))
    with pytest.raises(MeasurementError, match="masked or outside"):
        measure_result(write_result(tilted_block()), Recipe(level=tall))


@pytest.mark.parametrize("flank_px", [2.0, 5.0])
def test_a_step_is_the_same_however_long_its_line_is(flank_px: float, write_result: Write) -> None:
    folder = write_result(edge(flank_px), error_um=1.0)
    lengths = [600.0 * share for share in (0.7, 0.85, 1.0, 1.25, 1.5)]
    steps = tuple(
        StepTable(
            name=f"{length:g}", from_um=(597.0 - length / 2, 450.0), to_um=(597.0 + length / 2, 450.0), width_um=100
        )
        for length in lengths
    )
    found = measure_result(folder, Recipe(parameters=("height",), step=steps))
    values = [number(found, step.name, "height") for step in steps]
    heights = [one.value or 0.0 for one in values]
    assert max(heights) - min(heights) < min(one.uncertainty or 0.0 for one in values)
    for step, length in zip(steps, lengths, strict=True):
        assert number(found, step.name, "edge at").value == pytest.approx(length / 2, abs=2.0)
    assert [one.edges_um[0] for one in found.steps] == pytest.approx([length / 2 for length in lengths], abs=2.0)


def test_a_line_without_room_for_the_flank_says_so(write_result: Write) -> None:
    short = StepTable(name="short", from_um=(497.0, 450.0), to_um=(697.0, 450.0))
    found = measure_result(write_result(edge(8.0)), Recipe(parameters=("height",), step=(short,)))
    assert any("lengthen it on both sides" in words for words in number(found, "short", "height").warnings)


def test_a_ridge_is_a_kind(write_result: Write, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    across = {"from_um": (20.0, 450.0), "to_um": (1150.0, 450.0), "width_um": 50.0}
    ridge = StepTable(name="bar", kind="ridge", **across)  # type: ignore[arg-type]
    found = measure_result(write_result(tilted_block()), Recipe(parameters=("height",), step=(ridge,)))
    assert number(found, "bar", "height").value == pytest.approx(40.0, abs=0.2)
    assert number(found, "bar", "width").value == pytest.approx(495.0, abs=5.0)
    folder = write_result(-tilted_block(), "hollow")
    recipe = tmp_path / "recipe.toml"
    recipe.write_text(
        'parameters = ["height"]\n[[step]]\nname = "bar"\nkind = "ridge"\nfrom_um = [20, 450]\nto_um = [1150, 450]\n'
        '[[distance]]\nname = "span"\nfrom_um = [100, 100]\nto_um = [1000, 100]\n'
    )
    assert main(["measure", str(folder), "--recipe", str(recipe)]) == 1
    text = capsys.readouterr().out
    assert "not measured: " in text
    assert "Sa " in text
    assert "along the skin" in text
    assert "± not known, because that of the pixel pitch is not" in text


def test_a_length_has_the_pitchs_uncertainty(write_result: Write) -> None:
    span = DistanceTable(name="span", from_um=(100.0, 100.0), to_um=(1000.0, 100.0))
    recipe = Recipe(parameters=("height",), distance=(span,))
    scale = {"pixel_pitch_share": 0.002, "ball_radius_share": None}
    known = number(measure_result(write_result(tilted_block(), height_scale=scale), recipe), "span", "along the skin")
    assert known.uncertainty == pytest.approx(0.002 * 900.0, rel=0.01)
    assert not any("pixel pitch" in words for words in known.warnings)
    unknown = number(measure_result(write_result(tilted_block(), "other"), recipe), "span", "along the skin")
    assert unknown.uncertainty is None
    assert any("pixel pitch" in words for words in unknown.warnings)


@pytest.mark.parametrize("length_um", [600.0, 800.0, 1200.0, 2400.0, 4000.0])
def test_a_line_too_short_for_its_flank_knows_how_much_it_lacks(length_um: float) -> None:
    along = np.arange(0.0, length_um, 5.0)
    z_um = 50.0 * np.tanh((along - length_um / 2.0) / 110.0)  # its flank of 240 µm wants lines of 2.4 mm
    profile = Profile(z_um, 5.0)
    edges = find_edges(profile, "step")
    missing, sigma = 100.0 - step_height_um(profile, edges), definition_sigma_um(profile, edges)
    assert abs(missing) < 2.0 * sigma + 0.1 or (np.isnan(sigma) and length_um < 1500.0)
    assert length_um < 2400.0 or sigma < 0.5


SHAPES: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "tanh": lambda x: np.tanh(x / 110.0),
    "exponential": lambda x: np.sign(x) * (1.0 - np.exp(-np.abs(x) / 100.0)),
    "ramp": lambda x: np.clip(x / 150.0, -1.0, 1.0),
}


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("length_um", [250.0, 450.0, 600.0, 800.0, 1000.0, 1500.0, 3000.0])
@pytest.mark.parametrize("share", [0.5, 0.3])
def test_no_flank_and_no_place_on_the_line_makes_the_uncertainty_too_small(
    shape: str, length_um: float, share: float
) -> None:
    along = np.arange(0.0, length_um, 5.0)
    profile = Profile(50.0 * SHAPES[shape](along - share * length_um), 5.0)
    try:
        edges = find_edges(profile, "step")
        height, sigma = step_height_um(profile, edges), definition_sigma_um(profile, edges)
    except MeasurementError:
        assert length_um < 1000.0
        return
    assert np.isnan(sigma) or abs(100.0 - height) < 2.0 * sigma + 0.3
    assert np.isfinite(sigma) or length_um < 3000.0


def test_an_edge_near_one_end_is_measured_however_long_the_line_is() -> None:
    for length_um in (1000.0, 1500.0, 6000.0):
        along = np.arange(0.0, length_um, 5.0)
        profile = Profile(50.0 * np.tanh((along - 375.0) / 110.0), 5.0)
        edges = find_edges(profile, "step")
        assert edges.is_cut
        assert step_height_um(profile, edges) == pytest.approx(98.0, abs=0.5)


def sloping(along: np.ndarray) -> np.ndarray:
    """The flank of a sphere of 4 mm, beside its apex."""
    return -np.sqrt(4000.0**2 - (along + 500.0) ** 2)


def bent(along: np.ndarray) -> np.ndarray:
    return np.maximum(along - 900.0, 0.0) * 0.2


NO_STEP: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "noise": lambda along: np.random.default_rng(1).normal(0.0, 1.0, along.size),
    "ramp": lambda along: 0.3 * along,
    "flank": sloping,
    "crest": lambda along: sloping(np.abs(along - 1000.0) - 500.0),
    "bend": bent,
    "valley": lambda along: 0.2 * np.abs(along - 900.0),
    "wave": lambda along: 20.0 * np.sin(along / 150.0),
    "groove": lambda along: -20.0 * (np.abs(along - 1000.0) < 200.0),
    "half a wave": lambda along: 20.0 * np.sin((along / 2000.0 - 0.5) * np.pi),
    "nothing": lambda along: np.full(along.size, 3.0),
}


@pytest.mark.parametrize("shape", NO_STEP)
def test_a_profile_without_a_step_has_no_step_height(shape: str) -> None:
    along = np.arange(0.0, 2000.0, PITCH_UM)
    profile = Profile(NO_STEP[shape](along), PITCH_UM)
    with pytest.raises(MeasurementError):
        require_step(profile, find_edges(profile, "step"), are_found=True)


@pytest.mark.parametrize("shape", ["flank", "crest", "bend", "ramp", "valley", "half a wave", "nothing"])
def test_a_given_edge_makes_no_step(shape: str) -> None:
    along = np.arange(0.0, 2000.0, PITCH_UM)
    profile = Profile(NO_STEP[shape](along), PITCH_UM)
    with pytest.raises(MeasurementError, match="shows no step at the given edges"):
        require_step(profile, StepEdges("step", (950.0,)), are_found=False)


def test_a_step_under_noise_is_measured_at_given_edges() -> None:
    along = np.arange(0.0, 2000.0, PITCH_UM)
    profile = Profile(np.random.default_rng(1).normal(0.0, 1.0, along.size) + (along > 950.0), PITCH_UM)
    edges = StepEdges("step", (950.0,))
    require_step(profile, edges, are_found=False)
    assert step_height_um(profile, edges) == pytest.approx(1.0, abs=0.5)


@pytest.mark.parametrize("kind", ["groove", "ridge"])
@pytest.mark.parametrize("shape", ["step", "flank", "bend", "crest", "nothing"])
def test_a_profile_without_a_groove_has_no_depth(kind: StepKind, shape: str) -> None:
    along = np.arange(0.0, 2000.0, PITCH_UM)
    z_um = 50.0 * (along > 1000.0) if shape == "step" else NO_STEP[shape](along)
    profile = Profile(z_um, PITCH_UM)
    with pytest.raises(MeasurementError):
        require_step(profile, find_edges(profile, kind), are_found=True)


@pytest.mark.parametrize("kind", ["groove", "ridge"])
@pytest.mark.parametrize("width_um", [0.4, 1.2, 10.0])
def test_edges_without_samples_between_them_are_refused(kind: StepKind, width_um: float) -> None:
    profile = Profile(np.where(np.arange(60) > 30, 5.0, 0.0), PITCH_UM)
    with pytest.raises(MeasurementError, match="fewer than 3 valid samples"):
        require_step(profile, StepEdges(kind, (150.0, 150.0 + width_um)), are_found=False)


def test_a_measured_step_is_no_higher_than_what_its_line_spans(write_result: Write) -> None:
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float64)
    coin = 400.0 / (1.0 + np.exp((np.hypot(row - 90.0, column) - 150.0) / 12.0))  # rim of a coin under the gel
    lines = [(x, x + length) for length in (200.0, 350.0, 700.0) for x in (300.0, 500.0, 650.0, 700.0)]
    steps = tuple(
        StepTable(name=f"{start:g}-{end:g}", from_um=(start, 450.0), to_um=(min(end, 1190.0), 450.0))
        for start, end in lines
    )
    found = measure_result(write_result(coin.astype(np.float32)), Recipe(parameters=("height",), step=steps))
    for step in steps:
        one = number(found, step.name, "height")
        profile = coin[90, int(step.from_um[0] / PITCH_UM) : int(step.to_um[0] / PITCH_UM) + 1]
        if one.value is None:
            assert any("not measured" in words for words in one.warnings)
        else:
            assert one.uncertainty is not None
            assert abs(one.value) <= 1.1 * np.ptp(profile)
    assert set(found.failed) >= {"300-500", "700-900"}
