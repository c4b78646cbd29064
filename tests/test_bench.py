"""The benchmark: its quick run ends in a table and a file, and its marks follow their rules. No time is judged here."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.benchmarks.speed.marks import judge

ROOT = Path(__file__).parent.parent


def figures(**changed: Any) -> dict[str, Any]:
    """Integration of a full rectangle with every figure that its marks need."""
    part: dict[str, Any] = {
        "floor": {"min_ms": 4.0},
        "ours": {"min_ms": 20.0, "rmse_px": 0.0399},
        "scipy dctn, 2 workers": {"min_ms": 80.0},
        "exact": {"rmse_px": 0.04},
        "accuracy": {"over_exact": 1.002, "fields": 3},
    }
    return {"integration": {"unweighted": part | changed}}


def test_a_mark_is_met_at_its_limit_and_not_beyond() -> None:
    assert judge(figures())["unweighted_over_dctn"] | {"words": "", "item": 1} == {
        "value": 4.0, "mark": 3.0, "met": True, "sense": "at least", "item": 1, "words": "",
    }  # fmt: skip
    slow = {"scipy dctn, 2 workers": {"min_ms": 59.9}}
    assert judge(figures(**slow))["unweighted_over_dctn"]["met"] is False
    assert judge(figures())["unweighted_over_floor"]["met"] is True
    assert judge(figures(floor={"min_ms": 1.9}))["unweighted_over_floor"]["met"] is False


def test_speed_does_not_count_without_accuracy() -> None:
    marks = judge(figures(ours={"min_ms": 1.0, "rmse_px": 0.039}, accuracy={"over_exact": 1.011, "fields": 3}))
    assert marks["unweighted_over_dctn"]["value"] == 80.0
    assert marks["unweighted_over_dctn"]["met"] is False
    assert marks["unweighted_error"]["met"] is False


def beside_pyamg(over_exact: float) -> dict[str, Any]:
    solved = {"min_ms": 9000.0, "over_exact": 1.0001}
    ours = {"min_ms": 20.0, "over_exact": over_exact}
    part = {"ours, two-point": ours, "pyamg ruge-stuben": solved, "pyamg smoothed aggregation": solved}
    return {"integration": {"beside pyamg": part}}


def slopes(other_pixels: float) -> dict[str, Any]:
    ours = {"min_ms": 1.0, "mean_difference_to_numpy_deg": 1e-6, "share_of_other_pixels": other_pixels}
    return {"gradients": {"ours": ours, "torch network": {"min_ms": 20.0}}}


def video(off_sigma: float) -> dict[str, Any]:
    return {"video": {"weighted": {"best_fps": 30.0, "off_sigma_p90": off_sigma}}}


def handheld(height_error_share: float) -> dict[str, Any]:
    look = {"height_error_share": height_error_share, "untabulated_height_error_share": 0.15}
    return {"handheld": {"2028x1520": {"total": {"min_ms": 9.0}} | look}}


def scan(height_error_share: float) -> dict[str, Any]:
    return {"pipeline": {"4056x3040": {"min_ms": 2300.0, "megapixels": 12.3, "height_error_share": height_error_share}}}


@pytest.mark.parametrize(
    ("name", "right", "wrong"),
    [
        ("weighted_over_pyamg", beside_pyamg(1.003), beside_pyamg(1.02)),
        ("gradients_over_network", slopes(0.0), slopes(0.01)),
        ("video_weighted_fps", video(0.2), video(0.5)),
        ("pipeline_whole_s", scan(0.05), scan(0.8)),
        ("handheld_ms", handheld(0.155), handheld(0.17)),
    ],
)
def test_every_speed_asks_for_its_own_accuracy(name: str, right: dict[str, Any], wrong: dict[str, Any]) -> None:
    assert judge(right)[name]["met"] is True
    assert judge(wrong)[name]["met"] is False
    assert judge(right)[name]["value"] == judge(wrong)[name]["value"]


def test_a_missing_peer_is_neither_met_nor_missed() -> None:
    alone = {"gradients": {"ours": {"min_ms": 1.0}}, "integration": {"beside pyamg": {"ours": {"min_ms": 1.0}}}}
    marks = judge(alone)
    for name in ("gradients_over_network", "weighted_over_pyamg", "pipeline_s", "two_workers"):
        assert marks[name]["value"] is None
        assert marks[name]["met"] is None


def test_workers_are_judged_only_where_two_cores_are_idle() -> None:
    busy = {"two workers": {"scaling": 1.0, "scaling_of_counting": 1.1}}
    idle = {"two workers": {"scaling": 1.0, "scaling_of_counting": 1.95}}
    assert judge(busy)["two_workers"]["met"] is None
    assert judge(idle)["two_workers"]["met"] is False


def test_cost_per_pixel_compares_the_largest_scan_with_the_one_near_1_5_megapixels() -> None:
    scans = {str(mp): {"megapixels": mp, "min_ms": ms} for mp, ms in ((0.2, 90.0), (1.6, 160.0), (12.0, 1800.0))}
    assert judge({"pipeline": scans})["cost_pipeline"]["value"] == pytest.approx(1.5)


@pytest.mark.slow
def test_a_quick_run_prints_a_table_and_writes_every_mark(tmp_path: Path) -> None:
    out = tmp_path / "bench.json"
    # One thread: on a machine that does other work, waiting for a second one takes longer than the whole run.
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "NUMBA_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    run = subprocess.run(
        [sys.executable, "-m", "tests.benchmarks.speed.run", "--quick", "--out", out],
        cwd=tmp_path, env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    report = json.loads(out.read_text(encoding="utf-8"))
    assert report["marks"] == judge(report["figures"])
    assert all(set(mark) >= {"value", "mark", "met"} for mark in report["marks"].values())
    assert report["machine"]["quick"] is True
    assert ("torch network" in report["figures"]["gradients"]) == (
        report["marks"]["gradients_over_network"]["met"] is not None
    )
    assert report["marks"]["agreement_with_direct_px"]["met"] is True
    assert report["marks"]["unweighted_error"]["met"] is True
    assert report["marks"]["weighted_error"]["met"] is True
    (look,) = report["figures"]["handheld"].values()
    assert look["needs_numba"] is False
    told = run.stdout
    assert "Figures" in told
    assert all(mark["words"][:30] in told for mark in report["marks"].values())
    assert "scipy dctn, 2 workers" in told
