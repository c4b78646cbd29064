"""Trends: control limits and capability against numbers worked out by hand, and the command that draws them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest

from host_sync.cli.main import main
from host_sync.measurement.quantity import Quantity
from host_sync.measurement.trend import trend_of, trends

VALUES = [10.0, 12.0, 11.0, 13.0, 9.0]
MOVING = (2.0 + 1.0 + 2.0 + 4.0) / 4.0


def test_limits_and_capability_are_those_of_the_individuals_chart() -> None:
    found = trend_of(VALUES, [0.3] * 5, 5.0, 16.0)
    assert found is not None
    assert (found.count, found.mean, found.range) == (5, 11.0, 4.0)
    assert found.control_high - found.mean == pytest.approx(2.66 * MOVING)
    spread = MOVING / 1.128
    assert found.cp == pytest.approx(11.0 / (6.0 * spread))
    assert found.cpk == pytest.approx(5.0 / (3.0 * spread))
    assert found.ppk == pytest.approx(5.0 / (3.0 * np.std(VALUES, ddof=1)))
    assert found.mean_uncertainty == pytest.approx(np.hypot(0.3, np.std(VALUES, ddof=1) / np.sqrt(5.0)))
    chance = 1.0 / 45.0 + found.cpk**2 * (0.826 * 5 - 1.0) / 16.0
    assert found.cpk_uncertainty == pytest.approx(np.sqrt(chance + (0.3 / (3.0 * spread)) ** 2))
    words = found.text("µm")
    assert words.startswith("5 results: mean 11.00 ± 0.77 µm, range 4 µm, s 1.581 µm; control limits ")
    assert "Cpk 0.84 ± " in words


def test_the_uncertainty_of_cpk_is_its_spread_over_many_studies() -> None:
    random = np.random.default_rng(4)
    studies = [trend_of(random.normal(10.0, 1.0, 40).tolist(), [1e-9] * 40, 6.0, 14.0) for _ in range(400)]
    cpk = np.array([one.cpk for one in studies if one is not None])
    stated = np.median([one.cpk_uncertainty for one in studies if one is not None])
    assert 0.85 < stated / cpk.std() < 1.15


def test_what_jumps_lies_beyond_and_what_is_missing_keeps_its_place() -> None:
    found = trend_of([1.0, 1.1, None, 0.9, 1.0, 1.1, 0.9, 1.0, 9.0, 1.0, 1.1, 1.0, 0.9, 1.0, 1.1, 1.0], [None] * 16)
    assert found is not None
    assert found.beyond == (8,)
    assert (found.mean_uncertainty, found.cpk) == (None, None)
    assert "± not known" in found.text("")


def test_a_scan_that_was_taken_again_takes_no_part() -> None:
    again = ("replaced scan: it was taken again as rg-2",)
    found = trend_of([10.0, 99.0, 12.0, 11.0], [0.1] * 4, 5.0, 16.0, warnings=[(), again, (), ()])
    alone = trend_of([10.0, 12.0, 11.0], [0.1] * 3, 5.0, 16.0)
    assert found is not None
    assert alone is not None
    assert msgspec.structs.replace(found, replaced=0) == alone
    assert found.text("µm").endswith("; without 1 that were taken again")


@pytest.mark.parametrize("values", [[], [1.0], [None, 2.0, None]])
def test_fewer_than_two_have_no_trend(values: list[float | None]) -> None:
    assert trend_of(values, [None] * len(values)) is None


def test_directions_of_a_texture_are_averaged_over_the_half_turn_after_which_they_repeat() -> None:
    like = Quantity(
        subject="surface", name="Std", unit="°", value=None, uncertainty=1.0, coverage_factor=1, offset=0.0, samples=16,
        masked_share=0.0,
    )  # fmt: skip
    shown = (88.0, -88.0, 89.0, -89.0)
    seen = [SimpleNamespace(quantities=[msgspec.structs.replace(like, value=value)]) for value in shown]
    ((_, row, trend),) = trends(seen).values()
    assert [one.value for one in row] == [88.0, -88.0, 89.0, -89.0]
    assert abs(trend.mean) == pytest.approx(90.0)
    assert trend.deviation < 2.0


def test_equal_values_have_no_capability() -> None:
    found = trend_of([2.0, 2.0, 2.0], [0.1] * 3, 1.0, 3.0)
    assert found is not None
    assert (found.cpk, found.ppk) == (None, None)


def test_the_command_draws_what_has_a_tolerance(
    write_result: Callable[..., Path], wave: np.ndarray, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folders = [str(write_result(wave * (1.0 + 0.02 * at), name=f"part {at}", seed=at)) for at in range(4)]
    recipe = tmp_path / "recipe.toml"
    recipe.write_text(
        'parameters = ["Sa", "Sq"]\n[[tolerance]]\nnumber = "Sa"\nlow = 1\nhigh = 2\n'
        "[scale]\npixel_pitch_share = 0.001\n"
    )
    chart = tmp_path / "trend.png"
    assert main(["measure", *folders, "--recipe", str(recipe), "--trend", str(chart)]) == 0
    said = capsys.readouterr().out
    assert "surface Sa: 4 results: mean 1.3" in said
    assert "Cpk" in said
    assert chart.read_bytes().startswith(b"\x89PNG")
    assert main(["measure", folders[0], "--recipe", str(recipe), "--trend", str(chart)]) == 2
    assert "two results or more" in capsys.readouterr().err


def test_what_is_no_picture_is_refused_before_any_work(
    write_result: Callable[..., Path], wave: np.ndarray, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write_result(wave)
    (folder / "height_um.tif").write_bytes(b"never read")
    assert main(["measure", str(folder), str(folder), "--trend", str(tmp_path / "a.txt")]) == 2
    said = capsys.readouterr().err
    assert ".png, .pdf, .svg" in said
    assert "height_um" not in said


def test_json_holds_the_trends_with_doubts_and_one_coverage_factor(
    write_result: Callable[..., Path], wave: np.ndarray, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    failed = {"calibration_passed": False, "calibration_failed_checks": ["held-out error"]}
    recipe, chart = tmp_path / "recipe.toml", tmp_path / "trend.svg"
    recipe.write_text(
        'parameters = ["Sa"]\n[[tolerance]]\nnumber = "Sa"\nhigh = 2\n[scale]\npixel_pitch_share = 0.001\n'
    )
    trends = {}
    for k, facts in ((1, {}), (2, {}), (2, failed)):
        folders = [
            str(write_result(wave * (1.0 + 0.02 * at), name=f"part {at}", seed=at, **(facts if at == 3 else {})))
            for at in range(4)
        ]
        asked = ["measure", *folders, "--recipe", str(recipe), "-k", str(k), "--trend", str(chart), "--json"]
        assert main(asked) == 0
        *results, record = json.loads(capsys.readouterr().out)
        assert len(results) == 4
        assert record["schema"] == "retrograph.trend/1"
        (trends[k, bool(facts)],) = record["trends"]
    plain, double, doubted = trends[1, False], trends[2, False], trends[2, True]
    assert (plain["coverage_factor"], double["coverage_factor"]) == (1, 2)
    for name in ("mean_uncertainty", "cpk_uncertainty"):
        assert double[name] == pytest.approx(2.0 * plain[name])
        assert doubted[name] is None
    assert (double["doubts"], doubted["doubts"]) == ([], ["failed calibration (1 of 4)"])
    assert doubted["cpk"] == pytest.approx(plain["cpk"])
    assert "failed calibration (1 of 4)" in "".join(chart.read_text().split("<!--")[1:])


@pytest.mark.parametrize("option", ["--csv", "--json-file", "--trend"])
def test_what_cannot_be_written_is_refused_before_any_work(
    option: str, write_result: Callable[..., Path], wave: np.ndarray, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write_result(wave)
    (folder / "height_um.tif").write_bytes(b"never read")
    assert main(["measure", str(folder), option, "/dev/null/place.png"]) == 2
    said = capsys.readouterr().err
    assert "/dev/null/place.png cannot be written" in said
    assert "height_um" not in said


def test_a_missing_result_has_no_neighbours() -> None:
    drifted = trend_of([1.0, 1.1, None, 9.0, 9.1], [None] * 5)
    assert drifted is not None
    assert drifted.control_high - drifted.mean == pytest.approx(2.66 * 0.1)
    assert trend_of([1.0, None, 2.0], [None] * 3) is None
