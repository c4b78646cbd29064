"""The arithmetic behind `make accuracy`: what it measures of surfaces whose errors are known."""

from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from device.surface import HeightMap, surface_slopes
from hal.simulator.bench import TwinTruth
from host_sync.measurement.height_samples import StatedScale
from host_sync.results.reader import ResultRecord, ResultSurface
from tests.benchmarks.accuracy import (
    ball_error,
    marks,
    measured_cases,
    methods,
    pattern,
    rendered_sets,
    sigma_coverage,
)
from tests.drawings.board.wiring import wired_boards

PITCH_UM = 10.0
RADIUS_UM = 800.0


def sphere(radius_um: float) -> np.ndarray:
    row, column = np.mgrid[-60:61, -60:61] * PITCH_UM
    return np.sqrt(np.maximum(radius_um**2 - row**2 - column**2, 0.0)).astype(np.float32)


@pytest.fixture(scope="module")
def truth() -> TwinTruth:
    z_um = sphere(RADIUS_UM)
    row, column = np.mgrid[-60:61, -60:61] * PITCH_UM
    p, q = surface_slopes(HeightMap(z_um, PITCH_UM))
    return TwinTruth(z_um, p, q, np.hypot(row, column) < 500.0, PITCH_UM)


def test_a_perfect_surface_has_no_error(truth: TwinTruth) -> None:
    error = ball_error.judge_ball(HeightMap(truth.z_um, PITCH_UM), truth, RADIUS_UM)
    assert error.surface_deg.max() < 0.01
    assert error.smooth_deg.max() < 0.01
    assert error.masked_share == 0.0
    assert error.radius_ratio == pytest.approx(1.0, abs=1e-4)


def test_a_tilt_is_an_error_of_its_angle_and_a_bigger_ball_has_a_bigger_radius(truth: TwinTruth) -> None:
    judge_ball = ball_error.judge_ball
    flat = TwinTruth(0.0 * truth.z_um, 0.0 * truth.p, 0.0 * truth.q, truth.contact, PITCH_UM)
    tilted = np.tan(np.radians(3.0)) * PITCH_UM * np.arange(121.0, dtype=np.float32) * np.ones((121, 1), np.float32)
    error = judge_ball(HeightMap(tilted, PITCH_UM), flat, RADIUS_UM)
    assert error.surface_deg.mean() == pytest.approx(3.0, abs=0.01)
    assert error.smooth_deg.mean() == pytest.approx(3.0, abs=0.01)
    larger = judge_ball(HeightMap(sphere(1.05 * RADIUS_UM), PITCH_UM), truth, RADIUS_UM)
    assert larger.radius_ratio == pytest.approx(1.05, abs=1e-3)


def test_a_ball_that_a_near_camera_sees_larger_has_its_own_radius(truth: TwinTruth) -> None:
    camera_um = 8000.0
    row, column = np.mgrid[-60:61, -60:61] * PITCH_UM
    z_um = sphere(RADIUS_UM)
    for _ in range(60):  # where the ray of each pixel meets the ball
        closer = 1.0 - z_um / camera_um
        z_um = np.sqrt(np.maximum(RADIUS_UM**2 - (row**2 + column**2) * closer**2, 0.0)).astype(np.float32)
    seen = ball_error.judge_ball(HeightMap(z_um, PITCH_UM), truth, RADIUS_UM, camera_um)
    assert seen.radius_ratio == pytest.approx(1.0, abs=1e-3)
    assert ball_error.judge_ball(HeightMap(z_um, PITCH_UM), truth, RADIUS_UM).radius_ratio > 1.02


def test_noise_from_pixel_to_pixel_counts_in_the_surface_and_hardly_in_its_bias(truth: TwinTruth) -> None:
    noise = np.random.default_rng(1).normal(0.0, 0.5, truth.z_um.shape).astype(np.float32)
    error = ball_error.judge_ball(HeightMap(truth.z_um + noise, PITCH_UM), truth, RADIUS_UM)
    assert error.surface_deg.mean() > 1.0
    assert error.smooth_deg.mean() < 0.25 * error.surface_deg.mean()


def test_an_invalid_pixel_counts_as_fifteen_degrees(truth: TwinTruth) -> None:
    z_um = truth.z_um.copy()
    z_um[:60] = np.nan
    error = ball_error.judge_ball(HeightMap(z_um, PITCH_UM), truth, RADIUS_UM)
    assert error.masked_share == pytest.approx(0.5, abs=0.03)
    assert np.median(error.surface_deg[-10:]) == 15.0


def test_an_honest_sigma_covers_two_thirds_in_every_band(truth: TwinTruth) -> None:
    error = np.random.default_rng(2).normal(0.0, 3.0, truth.z_um.shape)
    shares = sigma_coverage.count_within(error, np.full(error.shape, 3.0), truth).shares()
    assert shares[:3] == pytest.approx([0.683] * 3, abs=0.04)
    assert sigma_coverage.NOTHING.shares() == [None] * 4


@pytest.mark.parametrize(("period", "angle"), [(4.0, 0.0), (8.0, 0.5)])
def test_the_kept_amplitude_is_that_of_the_surface(period: float, angle: float) -> None:
    patch = pattern.Patch("sinusoid", 110.0, 105.0, angle, 0.7, period)
    row, column = np.mgrid[:220, :220].astype(np.float64)
    slow = 1e-3 * column + 1e-5 * row**2
    assert pattern.kept_amplitude(0.6 * patch.height_px(column, row) + slow, patch) == pytest.approx(0.6, abs=0.01)
    assert patch.reach_px < 100.0


@pytest.mark.parametrize("angle", [0.07, 0.8])
def test_the_width_of_a_ridge_is_that_of_the_surface(angle: float) -> None:
    wide = pattern.Patch("ridge", 80.0, 80.0, angle, 0.0, 3.0)
    row, column = np.mgrid[:160, :160].astype(np.float64)
    height = wide.height_px(column, row)
    assert pattern.ridge_width_px(height, wide) == pytest.approx(3.0, abs=0.1)
    blurred = gaussian_filter1d(gaussian_filter1d(height, 2.0, axis=0), 2.0, axis=1)
    expected = np.hypot(3.0, 2.0 * 2.3548)
    assert pattern.ridge_width_px(blurred, wide) == pytest.approx(expected, rel=0.05)


def test_patches_differ_in_phase_and_angle_and_do_not_overlap() -> None:
    patches = pattern.spread_patches((1088, 1456))
    assert len({(patch.column, patch.row) for patch in patches}) == len(patches) == 32
    for number, patch in enumerate(patches):
        for other in patches[:number]:
            apart = np.hypot(patch.column - other.column, patch.row - other.row)
            assert apart > patch.reach_px + other.reach_px


def test_marks_are_met_by_what_keeps_their_bounds_alone() -> None:
    known = {mark.name: mark for mark in marks.all_marks()}
    assert len(known) == len(marks.all_marks())
    surface = known["oem-bga surface"]
    assert surface.met(1.15)
    assert not surface.met(1.16)
    assert not surface.met(None)
    assert not surface.met(float("nan"))
    covered = known["twin height within sigma, 0-10 deg"]
    assert [covered.met(share) for share in (0.59, 0.60, 0.76, 0.77)] == [False, True, True, False]
    record = marks.record({"finger surface": 3.0})["marks"]
    assert record["finger surface"]["met"] is True
    assert record["oem-bga masked"] == {"value": None, "mark": 0.03, "met": False, "unit": ""}


def test_a_refreshed_table_keeps_what_was_not_measured(tmp_path: Path) -> None:
    document = tmp_path / "paper.md"
    document.write_text(
        f"before\n{methods.BEGIN}\n| set | a |\n|---|---|\n| old | 1 |\n| finger | 2 |\n{methods.END}\nafter\n"
    )
    same = {"paper": 2.0, "direct": 1.0}
    methods.refresh(document, [methods.Row("finger", same, same, {"paper": 0.02, "direct": 0.01})])
    lines = document.read_text().splitlines()
    assert lines[0] == "before"
    assert lines[-1] == "after"
    assert lines[4:6] == ["| old | 1 |", "| finger | 2.00° | 1.00° | 2.00° | 1.00° | 2.0 % | 1.0 % |"]
    assert "| set | surface, paper | default |" in (Path(__file__).parents[1] / "docs" / "paper.md").read_text()


def test_figures_of_a_rendered_set_leave_out_what_has_no_zero() -> None:
    row = {"rms": 2.0, "h_in": 0.7, "h_x": 0.9, "s_in": 0.6, "feature": {"step": -1.0, "wave10px": -9.0}}
    rest = {**row, "rms": 0.4, "h_in": 0.5, "feature": {}}
    found = dict(rendered_sets.figures_of("far", {"step": {"ours": row}, "rest": {"ours": rest}, "lost": {}}))
    assert found["rendered far heights, rms"] == 2.0
    assert found["rendered far features off by"] == pytest.approx(0.01)
    assert found["rendered far untouched skin, rms"] == 0.4
    assert found["rendered far heights within sigma"] == pytest.approx(0.6)


def test_bands_of_tilt_are_over_the_pixels_of_all_scans() -> None:
    row = {"rms": 2.0, "h_in": 0.7, "h_x": 0.9, "s_in": 0.6, "feature": {"wave80px": -1.5, "wave10px": -9.0}}
    few, many = {"0-5": [100, 0.1, 0.9, 1.0]}, {"0-5": [300, 0.1, 0.5, 1.0], "30-45": [9, 0.1, 0.2, 1.0]}
    scans = {"waves": {"ours": {**row, "bands": few}}, "rest": {"ours": {**row, "feature": {}, "bands": many}}}
    found = dict(rendered_sets.figures_of("far", scans))
    assert found["rendered far slopes within sigma, 0-5 deg"] == pytest.approx(0.6)
    assert found["rendered far wave of 80 px off by"] == pytest.approx(0.015)
    assert not any("30-45" in name or "5-10" in name for name in found)


def test_every_figure_of_a_rendered_set_has_a_mark() -> None:
    row = {"rms": 2.0, "h_in": 0.7, "h_x": 0.9, "s_in": 0.6, "feature": {"wave80px": -1.5}}
    bands = {tilt: [1, 0.1, 0.6, 1.0] for tilt in marks.TILTS}
    scans = {"waves": {"ours": {**row, "bands": bands}}, "rest": {"ours": {**row, "feature": {}}}}
    named = {mark.name for mark in marks.all_marks() if mark.name.startswith("rendered matt ")}
    found = {name for name, _ in rendered_sets.figures_of("matt", scans)}
    assert found | {"rendered matt presses that teach"} == named


def test_every_board_that_is_wired_is_measured_as_built() -> None:
    full = {"pi4-imx477"}  # four times the pixels of the binned one, through the same lens
    assert set(marks.BUILT) | full == set(wired_boards())
    named = {mark.name for mark in marks.all_marks()}
    assert all(f"{board}: sinusoid of 8 px keeps" in named for board in marks.BUILT)


@pytest.mark.parametrize("own", ["shrunk", "raw"])
def test_numbers_of_a_result_are_judged_by_the_truth_whatever_detail_they_are_measured_on(own: str) -> None:
    rows, columns, pitch_um = 900, 1200, 12.0
    x_um = np.arange(columns) * pitch_um
    truth_um = np.tile(10.0 * np.sin(2.0 * np.pi * x_um / 600.0), (rows, 1)).astype(np.float32)
    record = ResultRecord(
        schema="retrograph.result/1", name="made", rows=rows, columns=columns, pixel_pitch_um=pitch_um,
        surface_detail=own,  # type: ignore[arg-type]
    )  # fmt: skip
    draws = (0.05 * np.linspace(-1.0, 1.0, 5))[:, None, None] * truth_um[None, ::4, ::4]
    shown, other = (HeightMap((share * truth_um).astype(np.float32), pitch_um) for share in (1.1, 1.2))
    found = ResultSurface(Path("made"), record, shown, draws.astype(np.float32), other=other)
    contact = np.ones((rows, columns), np.bool_)
    cases = {one.number: one for one in measured_cases.judged("sinusoid", found, truth_um, contact, StatedScale())}
    rough = 1.1 if own == "raw" else 1.2
    for number in ("sinusoid surface/Sa", "sinusoid line/Ra"):
        assert cases[number].value / cases[number].truth == pytest.approx(rough, rel=1e-3)
