"""Numbers with their ±: intervals hold a known truth, scale and holes count as they should, nothing is made up."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest

from device.surface import HeightMap
from host_sync.errors import MeasurementError
from host_sync.measurement.height_samples import FineNoise, HeightSamples, StatedScale
from host_sync.measurement.measure import measure, measure_result
from host_sync.measurement.measurement import Measurement, copies_among
from host_sync.measurement.quantity import Quantity, uncertainty_of, uncertainty_of_uncertainty
from host_sync.measurement.recipe import (
    AngleTable,
    DistanceTable,
    ProfileTable,
    RadiusTable,
    Recipe,
    StepTable,
    VolumeTable,
    from_options,
)
from host_sync.results.reader import read_result

Write = Callable[..., Path]
Draw = Callable[[np.random.Generator, float], np.ndarray]
PITCH_UM = 5.0
SHAPE = (180, 240)
LIKE_BALLS = StatedScale(unlike_balls_share=0.0)


def number(found: Measurement, name: str, subject: str = "surface") -> Quantity:
    return next(one for one in found.quantities if (one.subject, one.name) == (subject, name))


def test_a_sentence_says_it_all(write_result: Write, wave: np.ndarray) -> None:
    torn = wave.copy()
    torn[:, :10] = np.nan
    found = measure_result(write_result(torn), Recipe())
    sa = number(found, "Sa")
    assert sa.value == pytest.approx(4.0 / np.pi, rel=0.02)
    assert sa.samples == 16
    assert sa.sentence.startswith("Sa 1.2")
    assert sa.sentence.endswith(" µm (k = 1), 4.2 % masked")
    assert uncertainty_of_uncertainty(16) == pytest.approx(0.177, abs=1e-3)
    assert any("16 Monte Carlo samples" in note and "18%" in note for note in found.notes)


@pytest.mark.parametrize(
    ("value", "uncertainty", "words"),
    [
        (1.8349, 0.0612, "1.835 ± 0.061 µm"),
        (10_276_514.0, 1_279_768.0, "10300 ± 1300 mm"),
        (-96.4, 12.3, "-96 ± 12 µm"),
        (0.00012, 0.0000034, "0.0001200 ± 0.0000034 µm"),
        (3.0, None, "3 µm, ± not known"),
        (17_500.0, None, "17.5 mm, ± not known"),
        (17_500.0, 35.0, "17.500 ± 0.035 mm"),
        (1_750.0, None, "1750 µm, ± not known"),
        (None, None, "not defined"),
    ],
)
def test_two_figures_of_the_uncertainty_are_shown(value: float | None, uncertainty: float | None, words: str) -> None:
    shown = Quantity(
        subject="s",
        name="n",
        unit="µm",
        value=value,
        uncertainty=uncertainty,
        coverage_factor=1,
        offset=None,
        samples=16,
        masked_share=0.0,
    )
    assert shown.number == words


def test_k_2_doubles_the_uncertainty_and_says_so(write_result: Write, wave: np.ndarray) -> None:
    folder = write_result(wave)
    once, twice = (number(measure_result(folder, Recipe(coverage_factor=k)), "Sq") for k in (1, 2))
    assert once.uncertainty is not None
    assert twice.uncertainty == pytest.approx(2.0 * once.uncertainty)
    assert "(k = 2)" in twice.sentence


@pytest.mark.parametrize("name", ["Sa", "Sq"])
def test_stated_intervals_hold_the_truth_two_times_of_three(
    write_result: Write, wave: np.ndarray, smooth_error: Draw, name: str
) -> None:
    """Errors of the kind that the samples are drawn from are put into the surface itself."""
    recipe = Recipe(parameters=(name,), scale=LIKE_BALLS)
    samples = read_result(write_result(wave, error_um=0.5))
    truth = number(measure(replace(samples, samples_um=None), recipe), name).value
    assert truth is not None
    held = []
    for seed in range(40):
        random = np.random.default_rng(1000 + seed)
        measured = (wave + smooth_error(random, 0.5)).astype(np.float32)
        errors = np.stack([smooth_error(random, 0.5) for _ in range(16)]).astype(np.float32)
        found = number(measure(replace(samples, height=HeightMap(measured, PITCH_UM), samples_um=errors), recipe), name)
        assert found.value is not None
        assert found.uncertainty is not None
        held.append(abs(found.value - truth) <= found.uncertainty)
    assert 0.5 <= np.mean(held) <= 0.88


def test_the_uncertainty_of_an_extreme_holds_what_noise_adds_to_it(write_result: Write) -> None:
    """Crests and pits of a wave and of a groove are many places: the highest is raised in proportion to the noise."""
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]]
    line = ProfileTable(name="line", from_um=(50.0, 450.0), to_um=(1150.0, 450.0))
    pit = VolumeTable(name="pit", region_um=(300.0, 150.0, 900.0, 750.0), border_um=50.0)
    recipe = Recipe(parameters=("Sp", "Sv", "Sz"), scale=LIKE_BALLS, profile=(line,), volume=(pit,))
    names = (("surface", "Sz"), ("surface", "Sp"), ("line", "Pz"), ("pit", "largest depth"))
    for flat in (2.0 * np.sin(2.0 * np.pi * column / 30.0 + 0.2), -4.0 * ((column > 100) & (column < 140)) + 0.0 * row):
        plain = read_result(write_result(flat, samples=0))
        truth = [number(measure(plain, recipe), name, subject).value for subject, name in names]
        errors, stated = np.zeros((2, 10, len(names)))
        for seed in range(10):
            noise = 0.2 * np.random.default_rng(seed).standard_normal((17, *SHAPE)).astype(np.float32)
            measured = HeightMap(plain.height.z_um + noise[0], PITCH_UM)
            found = measure(replace(plain, height=measured, samples_um=noise[1:]), recipe)
            every = [number(found, name, subject) for subject, name in names]
            errors[seed] = [one.value - true for one, true in zip(every, truth, strict=True)]
            stated[seed] = [one.uncertainty for one in every]
        ratio = np.sqrt((errors**2).mean(axis=0) / (stated**2).mean(axis=0))
        assert ratio.min() > 0.4
        assert ratio.max() < 1.3


def test_the_filter_takes_what_it_removes_out_of_the_uncertainty_too(write_result: Write, wave: np.ndarray) -> None:
    folder = write_result(wave, error_um=0.5)
    recipes = (Recipe(scale=LIKE_BALLS), Recipe(l_filter_um=160.0, scale=LIKE_BALLS))
    plain, filtered = (number(measure_result(folder, one), "Sa") for one in recipes)
    assert plain.uncertainty is not None
    assert filtered.uncertainty is not None
    assert filtered.uncertainty < 0.6 * plain.uncertainty


def test_a_result_without_samples_has_no_uncertainty_and_says_so(write_result: Write, wave: np.ndarray) -> None:
    found = measure_result(write_result(wave, samples=0), Recipe())
    assert number(found, "Sa").uncertainty is None
    assert "± not known" in number(found, "Sa").sentence
    assert any("no height_draws_um.tif" in note for note in found.notes)


def test_scale_that_is_stated_moves_heights_and_lengths_as_it_should(write_result: Write, wave: np.ndarray) -> None:
    """Heights go with the square of the pitch; a sphere's radius, length² over height, does not feel it at all."""
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]] * PITCH_UM
    ball = np.sqrt(20_000.0**2 - (column - 600.0) ** 2 - (row - 450.0) ** 2) - 20_000.0
    recipe = Recipe(
        form="none",
        scale=StatedScale(pixel_pitch_share=0.01, unlike_balls_share=0.0),
        radius=(RadiusTable(name="ball", region_um=(0.0, 0.0, 1100.0, 850.0)),),
        distance=(DistanceTable(name="d", from_um=(0.0, 450.0), to_um=(1000.0, 450.0)),),
    )
    found = measure_result(write_result(ball, error_um=0.0), recipe)
    share = np.std([one.stretch for one in HeightSamples(read_result(found.folder), recipe.scale).surfaces()])
    sq, length, radius = number(found, "Sq"), number(found, "along the skin", "d"), number(found, "radius", "ball")
    assert sq.uncertainty / sq.value == pytest.approx(2.0 * share, rel=0.15)
    assert length.uncertainty / length.value == pytest.approx(share, rel=0.15)
    assert radius.uncertainty / radius.value < 0.1 * share
    measured = {"pixel_pitch_share": 0.01, "ball_radius_share": 0.002}
    folder = write_result(ball, "measured", error_um=0.0, height_scale=measured)
    # What the calibration measured is in the samples' heights already, which are zero here.
    assert number(measure_result(folder, recipe), "Sq").uncertainty is None
    assert number(measure_result(folder, recipe), "along the skin", "d").uncertainty is not None


def test_a_surface_unlike_the_balls_is_less_sure_by_the_share_that_is_said(
    write_result: Write, wave: np.ndarray
) -> None:
    folder = write_result(wave - 0.01 * np.arange(SHAPE[0])[:, None], error_um=0.0)
    found = measure_result(folder, Recipe(parameters=("Sq", "Ssk"), scale=StatedScale(unlike_balls_share=0.05)))
    sq = number(found, "Sq")
    assert sq.uncertainty / sq.value == pytest.approx(0.05, rel=1e-3)
    assert any("5.0% is included, for surfaces unlike the balls" in note for note in found.notes)


def test_an_unknown_pitch_leaves_a_length_without_uncertainty(write_result: Write, wave: np.ndarray) -> None:
    recipe = Recipe(distance=(DistanceTable(name="d", from_um=(0.0, 450.0), to_um=(1000.0, 450.0)),))
    found = measure_result(write_result(wave), recipe)
    assert number(found, "along the skin", "d").uncertainty is None
    assert any("pixel pitch is not known" in note for note in found.notes)


def test_noise_finer_than_the_draws_counts_in_the_slopes() -> None:
    """Draws on cells of four pixels say nothing of a slope noise of 0.05 between them; the noise says it."""
    sigma = np.full((400, 640), 0.05, np.float32)
    sigma[:, :100] = np.nan
    noise = FineNoise(sigma, np.zeros((16, 100, 160), np.float32), PITCH_UM)
    drawn = noise.sample_um(np.random.default_rng(0))
    slope = (drawn[:, 102:] - drawn[:, 100:-2]) / (2.0 * PITCH_UM)
    assert slope.std() == pytest.approx(0.05, rel=0.1)
    assert np.abs(drawn[:, :100]).max() == 0.0
    cells = drawn[:, 100:].reshape(100, 4, 135, 4).mean(axis=(1, 3))
    assert cells.std() < 0.5 * drawn[:, 100:].std()


def test_warnings_are_stated(write_result: Write, wave: np.ndarray) -> None:
    torn = wave.copy()
    torn[:60, :60] = np.nan
    folder = write_result(torn)
    beyond = np.zeros(SHAPE, np.uint8)
    beyond[:, 120:] = 255
    cv2.imwrite(str(folder / "extrapolated.png"), beyond)
    found = measure_result(folder, Recipe(l_filter_um=600.0))
    warnings = " ".join(number(found, "Sa").warnings)
    assert "within half a filter's nesting index" in warnings
    assert "50.0% of the area has slopes beyond those of the calibration balls: it is left out" in warnings
    assert number(found, "Sa").masked_share == pytest.approx(60 * 60 / torn.size)
    assert number(found, "Sa").left_out_share == 0.5
    assert number(found, "Sa").sentence.endswith("masked, 50 % left out")
    assert "upper limit" in " ".join(number(found, "Str").warnings)


def test_a_long_s_filter_and_a_texture_without_direction_are_warned_of(write_result: Write, wave: np.ndarray) -> None:
    rough = cv2.GaussianBlur(np.random.default_rng(3).standard_normal(SHAPE).astype(np.float32), (0, 0), 3.0)
    alike = measure_result(write_result(20.0 * rough), Recipe(parameters=("Std", "Sq")))
    assert "no direction" in " ".join(number(alike, "Std").warnings)
    assert number(alike, "Sq").warnings == ()
    smooth = measure_result(write_result(wave), Recipe(parameters=("Std", "Sq"), s_filter_um=500.0))
    assert "half a filter's nesting index" in " ".join(number(smooth, "Sq").warnings)
    assert "no direction" not in " ".join(number(smooth, "Std").warnings)


def test_slopes_beyond_the_calibration_are_left_out_unless_they_are_asked_for(
    write_result: Write, wave: np.ndarray
) -> None:
    wild = wave.copy()
    wild[40:50, 40:50] += 500.0
    folder = write_result(wild)
    beyond = np.zeros(SHAPE, np.uint8)
    beyond[35:55, 35:55] = 255
    cv2.imwrite(str(folder / "extrapolated.png"), beyond)
    left = number(measure_result(folder, Recipe()), "Sz")
    assert left.value < 10.0
    kept = number(measure_result(folder, Recipe(keep_extrapolated=True)), "Sz")
    assert kept.value > 450.0
    assert any(warning.endswith("calibration balls: it is kept") for warning in kept.warnings)
    assert kept.left_out_share == 0.0
    whole, part = measure_result(folder, Recipe(keep_extrapolated=True)), measure_result(folder, Recipe())
    for name in ("Sa", "Sq", "Sz", "Sdr"):
        assert abs(number(whole, name).value - number(part, name).value) <= 1.02 * number(part, name).uncertainty


def test_a_shape_without_an_l_filter_states_no_uncertainty_and_says_why(write_result: Write, wave: np.ndarray) -> None:
    folder = write_result(wave)
    plain, filtered = (measure_result(folder, one) for one in (Recipe(), Recipe(l_filter_um=600.0)))
    for name in ("Ssk", "Spk", "Smr1", "Str"):
        assert number(plain, name).uncertainty is None
        assert any("set l_filter_um" in warning for warning in number(plain, name).warnings)
        assert not any("set l_filter_um" in warning for warning in number(filtered, name).warnings)
    assert number(filtered, "Ssk").uncertainty is not None
    assert number(plain, "Sa").uncertainty is not None


def test_large_volumes_are_shown_in_cubic_millimetres() -> None:
    volume = Quantity(
        subject="pit", name="void volume", unit="µm³", value=2.345e8, uncertainty=1.2e7, coverage_factor=1, offset=None,
        samples=16, masked_share=0.0,
    )  # fmt: skip
    assert volume.number == "0.235 ± 0.012 mm³"
    assert msgspec.structs.replace(volume, value=2345.0, uncertainty=12.0).number == "2345 ± 12 µm³"


def test_lines_and_steps_carry_their_own_uncertainty(write_result: Write, wave: np.ndarray) -> None:
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]]
    z_um = 12.0 * (column > 119.5) + 0.0 * row
    ends = {"from_um": (50.0, 400.0), "to_um": (1150.0, 400.0)}
    recipe = Recipe(
        profile=(ProfileTable(name="line", l_filter_um=200.0, **ends), ProfileTable(name="raw", **ends)),
        step=(StepTable(name="edge", width_um=100.0, **ends),),
    )
    found = measure_result(write_result(z_um, error_um=0.3), recipe)
    edge = number(found, "height", "edge")
    assert edge.value == pytest.approx(12.0, abs=0.05)
    assert edge.uncertainty is not None
    assert 0.02 < edge.uncertainty < 2.0
    assert number(found, "Ra", "line").uncertainty is not None
    assert number(found, "Pt", "raw").value == pytest.approx(12.0, rel=0.6)
    assert found.profiles[0].sigma_um is not None
    assert "room for 4 of 5 sections" in number(found, "Ra", "line").warnings[0]


def test_a_wholly_masked_region_is_refused(write_result: Write, wave: np.ndarray) -> None:
    wave[:, :100] = np.nan
    with pytest.raises(MeasurementError, match="masked"):
        measure_result(write_result(wave), Recipe(region_um=(0.0, 0.0, 400.0, 400.0)))


def test_a_sphere_under_a_texture_comes_off_for_every_draw(write_result: Write, wave: np.ndarray) -> None:
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]] * PITCH_UM
    ball = np.sqrt(3_000.0**2 - (column - 600.0) ** 2 - (row - 450.0) ** 2)
    found = measure_result(write_result(ball + wave), Recipe(form="sphere"))
    assert number(found, "Sq").value == pytest.approx(np.sqrt(2.0), rel=0.03)
    assert number(found, "Sq").samples == 16


def test_what_is_nothing_but_noise_has_an_uncertainty_as_large_as_itself() -> None:
    flat, noisy, noisier = 0.0, 1.0, np.sqrt(2.0)
    standard, raised, _ = uncertainty_of(noisy, np.full(16, noisier))
    assert raised == pytest.approx(noisy - flat)
    assert standard == pytest.approx(1.0)
    assert uncertainty_of(10.0, np.full(16, np.hypot(10.0, 1.0)))[1] == pytest.approx(10.0 - np.sqrt(99.0), rel=1e-6)
    assert uncertainty_of(-3.0, np.full(16, -2.5))[1] == pytest.approx(0.5)
    assert uncertainty_of(1.0, np.full(3, 1.0)) is None
    crest, peak = 10.0, 4.0
    twice = np.full(16, crest + noisier * peak)
    assert uncertainty_of(crest + peak, twice, law="extreme")[0] == pytest.approx(peak)
    assert 0.7 * peak < uncertainty_of(crest + peak, twice, law="either")[0] < peak


def test_an_angle_between_regions_that_are_not_flat_says_so_and_is_as_unsure(write_result: Write) -> None:
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]] * PITCH_UM
    table = AngleTable(name="a", first_um=(100.0, 200.0, 500.0, 700.0), second_um=(700.0, 200.0, 1100.0, 700.0))
    ball = np.sqrt(2000.0**2 - (column - 600.0) ** 2 - (row - 450.0) ** 2)
    roof = -0.3 * np.abs(column - 600.0)
    on_ball, on_roof = (
        number(measure_result(write_result(z_um, name), Recipe(angle=(table,))), "angle", "a")
        for name, z_um in (("ball", ball), ("roof", roof))
    )
    assert [word.split(",")[0] for word in on_ball.warnings if "not flat" in word] == [
        "the first region is not flat",
        "the second region is not flat",
    ]
    assert not any("not flat" in word for word in on_roof.warnings)
    assert on_roof.uncertainty is not None
    assert on_ball.uncertainty is not None
    assert on_ball.uncertainty > 4.0 > 1.0 > on_roof.uncertainty


def test_a_region_that_reaches_beyond_the_field_says_that_its_part_inside_is_measured(
    write_result: Write, wave: np.ndarray
) -> None:
    folder = write_result(wave, samples=0)
    whole, beyond = ((0.0, 0.0, 1200.0, 900.0), (0.0, 0.0, 12_000.0, 900.0))
    for region, is_said in ((whole, False), (beyond, True)):
        table = RadiusTable(name="ball", region_um=region)
        found = measure_result(folder, Recipe(region_um=region, parameters=("Sa",), radius=(table,)))
        assert any("beyond the field" in word for word in number(found, "Sa").warnings) == is_said


def test_presses_that_do_not_show_a_step_are_no_copies_and_one_press_twice_is_one(
    write_result: Write, wave: np.ndarray
) -> None:
    alike = [measure_result(write_result(wave, f"press {at}", seed=at), Recipe(parameters=("Std",))) for at in (1, 2)]
    assert copies_among(alike) == {}
    unknown = [
        replace(one, quantities=tuple(msgspec.structs.replace(q, value=None) for q in one.quantities)) for one in alike
    ]
    assert copies_among(unknown) == {}
    twice = [measure_result(write_result(wave), Recipe(parameters=("Sa",))) for _ in range(2)]
    assert copies_among(twice) == {1: twice[0]}


def test_filters_and_borders_that_would_leave_nothing_are_refused(write_result: Write, wave: np.ndarray) -> None:
    with pytest.raises(MeasurementError, match="µm holds fewer than"):
        measure_result(write_result(wave), Recipe(l_filter_um=0.8))
    pits = [VolumeTable("pit", (100.0, 100.0, 400.0, 400.0), border_um=border_um) for border_um in (140.0, 160.0)]
    narrow, wide = (measure_result(write_result(wave), Recipe(volume=(pit,))) for pit in pits)
    assert narrow.failed == ()
    assert wide.failed == ("pit",)
    (refused,) = [part for part in wide.quantities if part.subject == "pit"]
    assert "border_um: 160 µm leaves nothing inside the region: narrow it" in refused.warnings[0]


def test_numbers_of_numpy_are_options() -> None:
    made = from_options(Recipe(), {"l_filter_um": np.float64(80.0), "coverage_factor": np.int64(2)})
    assert (made.l_filter_um, made.coverage_factor) == (80.0, 2)
